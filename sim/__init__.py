"""The plant (MuJoCo), lockstep scheduler, evaluation of choreographies."""
