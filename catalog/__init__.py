"""Data with a schema and its validating loaders: robot, skills, tracks, rules."""
