"""Errors of the policies folder."""

from __future__ import annotations

from downbeat.runtime.errors import DownbeatError


class PolicyError(DownbeatError):
    """A skill file, manifest or generator input is wrong."""


class SkillRejected(PolicyError):
    """A choreography cannot become a skill; the message names the limit and both numbers."""
