"""Builds skills from choreography: reference, feedback gains, ONNX, certificate."""
