"""The 50 Hz control process: pure tick, skills, transitions, safety."""
