"""What the skills in play are allowed: safety's limits, what counts as falling, certificates."""

from __future__ import annotations

import math
from collections.abc import Sequence

from downbeat.control.balance import LIMITS, FallLimits
from downbeat.policies.manifest import SkillLimits, SkillManifest

LEARNED_FALL_LIMITS = FallLimits(step_margin_m=-math.inf, tilt_ahead_rad=1.0, base_height_m=0.35)
"""Learned motions step and lean where they like, and catch themselves."""


def fall_limits(manifest: SkillManifest) -> FallLimits:
    """Return what counts as falling while a skill plays: its own limits, else its kind's."""
    kind = LEARNED_FALL_LIMITS if manifest.policy is not None else LIMITS[manifest.kind]
    own = manifest.limits
    return FallLimits(
        kind.step_margin_m if own.fall_step_margin_m is None else own.fall_step_margin_m,
        kind.tilt_ahead_rad if own.fall_tilt_ahead_rad is None else own.fall_tilt_ahead_rad,
        kind.base_height_m,
    )


def allowed_limits(playing: Sequence[SkillManifest]) -> SkillLimits:
    """Return what safety allows now: the skill's limits, during a blend the looser of the two."""
    if not playing:
        return SkillLimits()
    every = [manifest.limits for manifest in playing]
    if len(every) == 1:
        return every[0]
    return SkillLimits(
        tilt_rad=max(one.tilt_rad for one in every),
        joint_range_tolerance_rad=max(one.joint_range_tolerance_rad for one in every),
        joint_speed_ratio=max(one.joint_speed_ratio for one in every),
        torque_ratio=max(one.torque_ratio for one in every),
        saturated_s=max(one.saturated_s for one in every),
    )


def allowed_fall_limits(playing: Sequence[SkillManifest]) -> FallLimits | None:
    """Return what counts as falling now, in a blend the wider of the two; None: nothing plays."""
    if not playing:
        return None
    every = [fall_limits(manifest) for manifest in playing]
    if len(every) == 1:
        return every[0]
    return FallLimits(
        step_margin_m=min(one.step_margin_m for one in every),
        tilt_ahead_rad=max(one.tilt_ahead_rad for one in every),
        base_height_m=min(one.base_height_m for one in every),
    )


def uncertified(manifest: SkillManifest) -> str:
    """Return why a skill does not run on hardware; empty: it may."""
    if manifest.certificate is not None and manifest.certificate.passed:
        return ""
    return (
        f"Skill '{manifest.name}' has no passed certificate and does not run on hardware; "
        f"certify it with `downbeat policy certify {manifest.name} --write`."
    )
