"""The journal's record of a tick: what control consumed, and hashes of what it computed.

The consumed messages stand in the record as they came over the wire, so the journal alone
re-executes control, whatever the recorder lost; replay then holds the run's log against it.
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Mapping, Sequence
from hashlib import blake2b
from typing import Any

from downbeat.control.core import TickInput, TickOutput, hash64
from downbeat.lcm_types import (
    control_status_t,
    estop_t,
    g1_low_cmd_t,
    g1_low_state_t,
    operator_command_t,
    skill_request_t,
    transition_query_t,
    transition_verdict_t,
)
from downbeat.runtime.codec import codec_for

INPUT_LISTS: Mapping[str, Any] = {
    "requests": skill_request_t,
    "operator": operator_command_t,
    "estops": estop_t,
    "verdicts": transition_verdict_t,
}
STATUS_NUMBERS = struct.Struct("<7q7d")
COMPARED = (
    "mode",
    "skill",
    "phase",
    "input",
    "obs",
    "action",
    "command",
    "status",
    "changes",
    "query",
)
"""What a replay must reproduce, in the order in which a difference is reported."""


def _to_text(msg: Any, kind: Any) -> str:
    return base64.b64encode(codec_for(kind).encode(msg)).decode()


def _from_text(text: str, kind: Any, where: str) -> Any:
    return codec_for(kind).decode(base64.b64decode(text), where)


def tick_record(inputs: TickInput, output: TickOutput) -> dict[str, Any]:
    """Return the record of one tick: plain JSON values."""
    status = output.status
    record: dict[str, Any] = {
        "tick": inputs.tick,
        "utime": inputs.utime,
        "age": inputs.state_age_us,
        "state": None if inputs.state is None else _to_text(inputs.state, g1_low_state_t),
        "mode": status.mode,
        "skill": status.skill,
        "phase": status.phase_s,
        "input": status.input_hash,
        "obs": status.obs_hash,
        "action": status.action_hash,
        "command": command_hash(output.command),
        "status": status_hash(status),
        "changes": _hash(repr(output.changes).encode()),
    }
    if output.query is not None:
        record["query"] = query_hash(output.query)
    if inputs.foreign_states:
        record["foreign"] = inputs.foreign_states
    for name, kind in INPUT_LISTS.items():
        messages: Sequence[Any] = getattr(inputs, name)
        if messages:
            record[name] = [_to_text(msg, kind) for msg in messages]
    return record


def input_of(record: Mapping[str, Any]) -> TickInput:
    """Return what a recorded tick consumed; the messages pass the codec's checks again."""
    where = f"journal, tick {record['tick']}"
    lists = {
        name: tuple(_from_text(text, kind, where) for text in record.get(name, ()))
        for name, kind in INPUT_LISTS.items()
    }
    state = record["state"]
    return TickInput(
        utime=record["utime"],
        tick=record["tick"],
        state=None if state is None else _from_text(state, g1_low_state_t, where),
        state_age_us=record["age"],
        foreign_states=record.get("foreign", 0),
        **lists,
    )


def command_hash(command: g1_low_cmd_t) -> int:
    """Return a hash of everything the motors see."""
    return hash64(
        command.joint_pos_target,
        command.joint_vel_target,
        command.joint_torque_ff,
        command.joint_stiffness,
        command.joint_damping,
        float(command.mode),
    )


def query_hash(query: transition_query_t) -> int:
    """Return a hash of a question to the checker, without what the bus adds to it."""
    numbers = (query.header.utime, query.query_id, query.request_id, query.exit_utime)
    texts = (query.from_skill, query.to_skill, query.mode, query.control_state_hash)
    return _hash(repr((numbers, texts, tuple(query.qpos), tuple(query.qvel))).encode())


def status_hash(status: control_status_t) -> int:
    """Return a hash of what control says, without what the machine's timing adds to it."""
    numbers = STATUS_NUMBERS.pack(
        status.header.utime,
        status.tick,
        status.state_seq,
        status.request_id,
        status.mode,
        status.state_age_us,
        status.fault,
        status.phase_s,
        status.phase_rate,
        status.blend_weight,
        status.tilt,
        status.base_height,
        status.support_margin,
        status.target_jump,
    )
    texts = f"{status.skill}|{status.previous_skill}|{status.fault_text}"
    return _hash(numbers + texts.encode())


def _hash(data: bytes) -> int:
    return int.from_bytes(blake2b(data, digest_size=8).digest(), "big", signed=True)
