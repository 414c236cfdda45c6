"""The robot side: LCM on one side, the G1's own DDS on the other. See docs/robot.md."""
