"""The channel table: channel -> type, rate, publisher, staleness. The one place for these."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from downbeat import lcm_types as t


@dataclass(frozen=True)
class Channel:
    """One channel of the bus.

    Attributes:
        name: LCM channel name.
        type: Generated LCM class.
        rate_hz: Nominal rate [Hz]; 0.0 for event channels.
        publishers: Names of the processes that may publish it; empty: anybody.
        stale_after_s: Age [s] at which the last message no longer counts; inf for events.
        logged: Whether the recorder writes it.
        group: Multicast group: "main", or "audio" for bulk sound.
    """

    name: str
    type: Any
    rate_hz: float
    publishers: tuple[str, ...]
    stale_after_s: float
    logged: bool = True
    group: str = "main"


INF = float("inf")

_TABLE = (
    Channel("G1_LOW_STATE", t.g1_low_state_t, 500.0, ("sim", "bridge"), 0.04),
    Channel("G1_LOW_CMD", t.g1_low_cmd_t, 50.0, ("control",), 0.1),
    Channel("SIM_TRUTH", t.sim_truth_t, 50.0, ("sim",), 0.2),
    Channel("OPERATOR_COMMAND", t.operator_command_t, 0.0, ("operator", "bridge"), INF),
    Channel("ESTOP", t.estop_t, 0.0, (), INF),
    Channel(
        "AUDIO_CHUNK",
        t.audio_chunk_t,
        20.0,
        ("listener", "source"),
        1.0,
        logged=False,
        group="audio",
    ),
    Channel("AUDIO_SOURCE", t.audio_source_t, 0.0, ("listener", "source"), INF),
    Channel("AUDIO_CLASS", t.audio_class_t, 4.0, ("listener",), 2.0),
    Channel("MUSIC_BEAT", t.music_beat_t, 4.0, ("listener",), 2.0),
    Channel("MUSIC_MATCH", t.music_match_t, 4.0, ("listener",), 2.0),
    Channel("TRANSCRIPT", t.transcript_t, 0.0, ("speech",), INF),
    Channel("SPEECH_INTENT", t.speech_intent_t, 0.0, ("speech",), INF),
    Channel("SPEECH", t.speech_t, 0.0, ("speech",), INF),
    Channel("SKILL_REQUEST", t.skill_request_t, 0.0, ("conductor",), INF),
    Channel("OPERATOR_SKILL_REQUEST", t.skill_request_t, 0.0, ("operator",), INF),
    Channel("SKILL_STATUS", t.skill_status_t, 0.0, ("control",), INF),
    Channel("CONTROL_STATUS", t.control_status_t, 50.0, ("control",), 0.2),
    Channel("TRANSITION_QUERY", t.transition_query_t, 0.0, ("control",), INF),
    Channel("TRANSITION_VERDICT", t.transition_verdict_t, 0.0, ("checker",), INF),
    Channel("HEARTBEAT", t.heartbeat_t, 2.0, (), 2.0),
)

CHANNELS: MappingProxyType[str, Channel] = MappingProxyType({c.name: c for c in _TABLE})
"""Every channel of Downbeat by name."""
