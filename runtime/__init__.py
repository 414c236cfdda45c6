"""Plumbing with no robot and no audio: clock, bus, supervisor, config, log, journal."""
