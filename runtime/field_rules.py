"""What each field of each message may hold: range, declared constants, unit norm, NaN.

The .lcm files say it in words, this table says it in numbers; the codec checks every decoded field
against it. Every float not listed must be finite; integers not listed may be anything.
A key is `type.field`; fields of a nested struct are listed under the nested type.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

MAX_FLOAT32 = 3.4028234663852886e38
MAX_FLOAT64 = 1.7976931348623157e308

UNIT_NORM_TOLERANCE = 0.01
"""Float32 quaternions of a healthy robot are off by 1e-6; a broken one is off by far more."""


@dataclass(frozen=True, slots=True)
class FieldRule:
    """What one field may hold.

    Attributes:
        low: Smallest value, None: anything the type holds (floats: anything finite).
        high: Largest value, likewise.
        nan_ok: NaN is a valid value ("unknown").
        constants: The declared values of an enumeration; None: not an enumeration.
        unit_norm: The array is a unit quaternion.
    """

    low: float | None = None
    high: float | None = None
    nan_ok: bool = False
    constants: tuple[int, ...] | None = None
    unit_norm: bool = False

    @property
    def low_value(self) -> float:
        """Smallest value, -inf if any."""
        return -math.inf if self.low is None else self.low

    @property
    def high_value(self) -> float:
        """Largest value, inf if any."""
        return math.inf if self.high is None else self.high

    def describe(self) -> str:
        """Say what would be valid."""
        if self.constants is not None:
            return "one of " + ", ".join(str(value) for value in self.constants)
        if self.low is None and self.high is None:
            text = "a finite number"
        elif self.high is None:
            text = f"at least {self.low:g}"
        else:
            text = f"{self.low:g}..{self.high:g}"
        if self.unit_norm:
            text = "a unit quaternion"
        return text + (" or NaN" if self.nan_ok else "")


RANGES: Mapping[str, tuple[float | None, float | None]] = {
    "header_t.utime": (0, None),
    "header_t.seq": (0, None),
    "imu_t.quat": (-1.01, 1.01),
    "imu_t.gyro": (-200.0, 200.0),
    "imu_t.accel": (-1e4, 1e4),
    "imu_t.rpy": (-6.3, 6.3),
    "g1_low_state_t.joint_pos": (-10.0, 10.0),
    "g1_low_state_t.joint_vel": (-200.0, 200.0),
    "g1_low_state_t.joint_torque_est": (-1000.0, 1000.0),
    "g1_low_state_t.battery_soc": (0.0, 1.0),
    "g1_low_cmd_t.joint_pos_target": (-10.0, 10.0),
    "g1_low_cmd_t.joint_vel_target": (-200.0, 200.0),
    "g1_low_cmd_t.joint_torque_ff": (-1000.0, 1000.0),
    "g1_low_cmd_t.joint_stiffness": (0.0, 1e4),
    "g1_low_cmd_t.joint_damping": (0.0, 1e4),
    "sim_truth_t.qpos": (-1e4, 1e4),
    "sim_truth_t.qvel": (-1e4, 1e4),
    "audio_chunk_t.first_sample": (0, None),
    "audio_chunk_t.first_sample_utime": (0, None),
    "audio_chunk_t.sample_rate_hz": (1, 1_000_000),
    "audio_chunk_t.num_samples": (0, 10_000_000),
    "audio_class_t.v_frac": (0.0, 1.0),
    "audio_class_t.rms_dbfs": (-1000.0, 100.0),
    "audio_source_t.duration_s": (0.0, 1e9),
    "control_status_t.blend_weight": (0.0, 1.0),
    "control_status_t.tilt": (0.0, 3.2),
    "music_beat_t.confidence": (0.0, 1.0),
    "music_beat_t.period_s": (0.0, 10.0),
    "music_beat_t.phase_std_s": (0.0, 1e9),
    "music_match_t.similarity": (-1.01, 1.01),
    "music_match_t.tau_std_s": (0.0, 1e9),
    "skill_request_t.request_id": (1, None),
    "skill_request_t.duration_s": (0.0, 1e9),
    "skill_request_t.velocity": (-10.0, 10.0),
    "speech_intent_t.distance_m": (0.0, 1e3),
    "speech_intent_t.duration_s": (0.0, 1e9),
    "speech_intent_t.repeat": (0, 1_000),
    "speech_intent_t.score": (0.0, 1.0),
    "speech_intent_t.utterance_id": (1, None),
    "speech_t.duration_s": (0.0, 1e9),
    "transcript_t.confidence": (0.0, 1.0),
    "transition_query_t.blend_s": (0.0, 1e3),
    "transition_query_t.stand_s": (0.0, 1e3),
    "transition_query_t.horizon_s": (0.0, 1e3),
    "transition_query_t.num_rollouts": (0, 1_000_000),
    "transition_query_t.num_bytes": (0, 100_000_000),
    "transition_verdict_t.num_rollouts": (0, 1_000_000),
    "transition_verdict_t.num_fallen": (0, 1_000_000),
    "transition_verdict_t.p_fall_upper": (0.0, 1.0),
}
"""Bounds of numbers, inclusive; wide enough for a robot in trouble, too narrow for garbage."""

NAN_ALLOWED: frozenset[str] = frozenset(
    {
        "audio_class_t.p_music",
        "audio_class_t.p_speech",
        "audio_class_t.v_frac",
        "audio_source_t.duration_s",
        "control_status_t.base_height",
        "control_status_t.support_margin",
        "g1_low_state_t.battery_soc",
        "g1_low_state_t.imu_torso",
        "music_beat_t.phase_std_s",
        "music_match_t.next_boundary_s",
        "music_match_t.tau_std_s",
        "skill_status_t.phase_s",
        "transcript_t.confidence",
    }
)
"""Fields whose documentation says NaN; a nested struct's name stands for all its fields."""

UNIT_QUATERNIONS: frozenset[str] = frozenset({"imu_t.quat"})

_REQUEST_SOURCES = ("SOURCE_OPERATOR", "SOURCE_MUSIC", "SOURCE_SPEECH", "SOURCE_SCRIPT")

ENUMERATIONS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "audio_class_t.label": ("audio_class_t", ("SKIP", "MUSIC", "SPEECH")),
    "audio_source_t.state": ("audio_source_t", ("STARTED", "FINISHED", "FAILED")),
    "control_status_t.mode": (
        "control_status_t",
        (
            "ZERO_TORQUE",
            "DAMPING",
            "MOVE_TO_POSE",
            "STAND",
            "SKILL",
            "TRANSITION",
            "FALLBACK",
            "ESTOP",
        ),
    ),
    "estop_t.level": ("estop_t", ("CLEAR", "DAMP", "ZERO_TORQUE")),
    "g1_low_cmd_t.mode": ("g1_low_cmd_t", ("MODE_ZERO_TORQUE", "MODE_DAMPING", "MODE_POSITION")),
    "g1_low_state_t.source": (
        "g1_low_state_t",
        ("SOURCE_SIM", "SOURCE_HARDWARE", "SOURCE_REPLAY"),
    ),
    "heartbeat_t.state": ("heartbeat_t", ("STARTING", "READY", "DEGRADED", "STOPPING")),
    "music_beat_t.state": ("music_beat_t", ("NONE", "SEARCHING", "FOLLOWING")),
    "music_match_t.method": ("music_match_t", ("NONE", "FINGERPRINT", "EMBEDDING")),
    "music_match_t.lock": ("music_match_t", ("LOST", "CANDIDATE", "LOCKED")),
    "operator_command_t.command": (
        "operator_command_t",
        ("CONFIRM", "ARM", "DISARM", "STAND", "RELEASE", "CLEAR_TRIP"),
    ),
    "skill_request_t.operation": ("skill_request_t", ("START", "CANCEL", "REPLACE", "RETIME")),
    "skill_request_t.source": ("skill_request_t", _REQUEST_SOURCES),
    "skill_status_t.source": ("skill_request_t", _REQUEST_SOURCES),
    "skill_status_t.state": (
        "skill_status_t",
        (
            "QUEUED",
            "PLANNING",
            "PROVEN",
            "PRIMING",
            "BLENDING",
            "RUNNING",
            "DONE",
            "REFUSED",
            "CANCELLED",
            "EXPIRED",
            "PREEMPTED",
            "ABORTED",
        ),
    ),
    "speech_intent_t.kind": (
        "speech_intent_t",
        ("STOP", "SKILL", "AGAIN", "TEMPO", "RESUME", "CHAT"),
    ),
    "speech_t.state": ("speech_t", ("REQUESTED", "STARTED", "FINISHED", "FAILED")),
    "transition_verdict_t.verdict": (
        "transition_verdict_t",
        ("UNKNOWN", "SAFE", "UNSAFE", "TIMED_OUT"),
    ),
}
"""Enumeration fields: the type that declares the constants, and their names."""


def rule_for(key: str, nan_ok: bool, types: Mapping[str, Any]) -> FieldRule:
    """Return the rule of one field.

    Args:
        key: `type.field` of the struct that declares the field.
        nan_ok: An enclosing struct allows NaN.
        types: Generated classes by name.
    """
    low, high = RANGES.get(key, (None, None))
    constants = None
    if key in ENUMERATIONS:
        owner, names = ENUMERATIONS[key]
        constants = tuple(sorted({int(getattr(types[owner], name)) for name in names}))
    return FieldRule(
        low=low,
        high=high,
        nan_ok=nan_ok or key in NAN_ALLOWED,
        constants=constants,
        unit_norm=key in UNIT_QUATERNIONS,
    )
