"""Plumbing with no robot and no audio: clock, bus, rate keeper, supervisor, config, log, journal."""
