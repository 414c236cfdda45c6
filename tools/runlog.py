"""A recorded run as columns, read from its LCM event log alone."""

from __future__ import annotations

import struct
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import lcm
import numpy as np
from numpy.typing import NDArray

from downbeat.lcm_types import g1_low_state_t
from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.codec import CodecError, codec_for
from downbeat.tools.errors import ToolError

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

LOG_NAME = "run.lcmlog"
AUDIO_NAME = "mashup.wav"
"""The show's sound, if the run folder holds it."""
STATE_CHANNEL = "G1_LOW_STATE"
STATE_HEAD = struct.Struct(">8sqqqqb")
"""Fingerprint, header (utime, seq, epoch), tick, source: states are many, and only these count."""
EVENT_CHANNELS = (
    "AUDIO_SOURCE",
    "AUDIO_CLASS",
    "MUSIC_MATCH",
    "MUSIC_BEAT",
    "SKILL_REQUEST",
    "OPERATOR_SKILL_REQUEST",
    "SKILL_STATUS",
    "TRANSCRIPT",
    "SPEECH_INTENT",
    "SPEECH",
    "TRANSITION_QUERY",
    "TRANSITION_VERDICT",
    "HEARTBEAT",
)


@dataclass(frozen=True)
class ControlColumns:
    """CONTROL_STATUS, one row per tick: (n,) each; names as in the message."""

    utime: I64
    skill: NDArray[np.str_]
    previous_skill: NDArray[np.str_]
    blend_weight: F64
    phase_s: F64
    phase_rate: F64
    mode: I64
    fault: I64
    lateness_us: I64
    compute_us: I64
    missed: I64
    states_lost: I64
    rejected: I64

    @property
    def executed(self) -> NDArray[np.str_]:
        """The skill with at least half the weight, per tick."""
        return np.where(self.blend_weight >= 0.5, self.skill, self.previous_skill)


@dataclass(frozen=True)
class TruthColumns:
    """SIM_TRUTH: `utime` (n,), `qpos` (n, 36), `qvel` (n, 35)."""

    utime: I64
    qpos: F64
    qvel: F64


@dataclass(frozen=True)
class StateColumns:
    """G1_LOW_STATE: when and which physics step, (n,) each."""

    utime: I64
    tick: I64
    source: I64


@dataclass(frozen=True)
class RunLog:
    """Everything that reports need.

    Attributes:
        control: Ticks of control.
        truth: True states of the plant; empty for a real robot.
        states: Times and ticks of measured states.
        events: Decoded messages of the event channels, in the log's order.
        bad_messages: Messages in the log that did not decode.
    """

    control: ControlColumns
    truth: TruthColumns
    states: StateColumns
    events: dict[str, list[Any]]
    bad_messages: int


def read_run(path: Path) -> RunLog:
    """Read a log file.

    Raises:
        ToolError: It is missing, or holds no tick of control.
    """
    if not path.is_file():
        raise ToolError(
            f"There is no log {path}; a run folder holds {LOG_NAME}, written by the recorder."
        )
    messages, bad = _decode(path)
    if not messages["CONTROL_STATUS"]:
        raise ToolError(
            f"The log {path} holds no CONTROL_STATUS; it has"
            f" {', '.join(sorted(messages)) or 'no message of ours'}."
        )
    return RunLog(
        control=_control(messages["CONTROL_STATUS"]),
        truth=_truth(messages["SIM_TRUTH"]),
        states=_states(messages[STATE_CHANNEL]),
        events={name: messages[name] for name in EVENT_CHANNELS},
        bad_messages=bad,
    )


def _decode(path: Path) -> tuple[dict[str, list[Any]], int]:
    wanted = {"CONTROL_STATUS", "SIM_TRUTH", *EVENT_CHANNELS}
    codecs = {name: codec_for(CHANNELS[name].type) for name in wanted}
    messages: dict[str, list[Any]] = defaultdict(list)
    fingerprint = g1_low_state_t._get_packed_fingerprint()
    bad = 0
    log = lcm.EventLog(str(path), "r")
    try:
        for event in log:
            if event.channel == STATE_CHANNEL:
                if event.data[:8] == fingerprint and len(event.data) > STATE_HEAD.size:
                    messages[STATE_CHANNEL].append(STATE_HEAD.unpack_from(event.data))
                else:
                    bad += 1
                continue
            codec = codecs.get(event.channel)
            if codec is None:
                continue
            try:
                messages[event.channel].append(codec.decode(event.data, event.channel))
            except CodecError:
                bad += 1
    finally:
        log.close()
    return messages, bad


def _control(ticks: list[Any]) -> ControlColumns:
    ticks = sorted(ticks, key=lambda m: m.header.utime)

    def ints(name: str) -> I64:
        return np.array([getattr(m, name) for m in ticks], dtype=np.int64)

    def floats(name: str) -> F64:
        return np.array([getattr(m, name) for m in ticks], dtype=np.float64)

    return ControlColumns(
        utime=np.array([m.header.utime for m in ticks], dtype=np.int64),
        skill=np.array([m.skill for m in ticks], dtype=np.str_),
        previous_skill=np.array([m.previous_skill for m in ticks], dtype=np.str_),
        blend_weight=floats("blend_weight"),
        phase_s=floats("phase_s"),
        phase_rate=floats("phase_rate"),
        mode=ints("mode"),
        fault=ints("fault"),
        lateness_us=ints("lateness_us"),
        compute_us=ints("compute_us"),
        missed=ints("missed"),
        states_lost=ints("states_lost"),
        rejected=ints("rejected"),
    )


def _truth(states: list[Any]) -> TruthColumns:
    if not states:
        return TruthColumns(np.zeros(0, np.int64), np.zeros((0, 36)), np.zeros((0, 35)))
    return TruthColumns(
        utime=np.array([m.header.utime for m in states], dtype=np.int64),
        qpos=np.array([m.qpos for m in states], dtype=np.float64),
        qvel=np.array([m.qvel for m in states], dtype=np.float64),
    )


def _states(heads: list[Any]) -> StateColumns:
    columns = np.array([head[1:] for head in heads], dtype=np.int64).reshape(-1, 5)
    return StateColumns(utime=columns[:, 0], tick=columns[:, 3], source=columns[:, 4])
