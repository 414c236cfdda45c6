"""What a tick takes and gives, and the small functions that turn messages into arrays and back."""

from __future__ import annotations

from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Any, cast

import numpy as np

from downbeat.control.observation import RobotState
from downbeat.control.prover import ProofConfig
from downbeat.control.requests import StatusChange
from downbeat.control.skill import JointTargets
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

DAMPING_GAIN = 5.0
"""[N m s/rad] of every joint in damping, as the bridge: the robot sinks slowest (docs/robot.md)."""
COMMAND_VALID_US = 100_000
"""A command holds for five ticks; then the receiver goes to damping."""


@dataclass(frozen=True, slots=True)
class TickInput:
    """Everything one tick consumes.

    Attributes:
        utime: [us] of the tick, a multiple of 20 ms.
        tick: Tick number.
        state: The newest valid G1_LOW_STATE, None before the first.
        state_age_us: Its age [us]; negative if it is stamped in the future.
        requests: New skill requests, in order.
        operator: New operator commands, in order.
        estops: New emergency stop messages, in order.
        foreign_states: Messages of a second publisher on G1_LOW_STATE so far.
        verdicts: New answers of the checker, in order.
    """

    utime: int
    tick: int
    state: g1_low_state_t | None
    state_age_us: int
    requests: tuple[skill_request_t, ...] = ()
    operator: tuple[operator_command_t, ...] = ()
    estops: tuple[estop_t, ...] = ()
    foreign_states: int = 0
    verdicts: tuple[transition_verdict_t, ...] = ()


@dataclass(frozen=True, slots=True)
class TickOutput:
    """What a tick produces; sequence numbers, lateness and counters are filled in by the node."""

    command: g1_low_cmd_t
    status: control_status_t
    changes: list[StatusChange]
    tripped: bool = False
    """The robot went to damping or emergency stop in this tick."""
    query: transition_query_t | None = None
    """A plan that the checker shall simulate."""


@dataclass(frozen=True, slots=True)
class CoreConfig:
    """Settings of the core.

    Attributes:
        auto_arm: In simulation, move to the start pose and stand without an operator.
        fallback: The skill that catches a fall; empty: the best of our own (docs/safety.md).
        proof: How sure a change of skill must be.
    """

    auto_arm: bool = True
    fallback: str = ""
    proof: ProofConfig = field(default_factory=ProofConfig)


def robot_state(msg: g1_low_state_t) -> RobotState:
    """Return what a message measures (float32, motor order); place and speed are not known."""
    imu = msg.imu_pelvis
    return RobotState(
        np.asarray(imu.quat, np.float32),
        np.asarray(imu.gyro, np.float32),
        np.asarray(msg.joint_pos, np.float32),
        np.asarray(msg.joint_vel, np.float32),
    )


def hash64(*arrays: object) -> int:
    """Return a signed 64-bit hash of the arrays' bytes; equal hashes mean equal bits."""
    digest = blake2b(digest_size=8)
    for array in arrays:
        digest.update(np.asarray(array, np.float32).tobytes())
    return int.from_bytes(digest.digest(), "big", signed=True)


def make_command(inputs: TickInput, mode: int, targets: JointTargets) -> g1_low_cmd_t:
    """Return a G1_LOW_CMD that answers the state of this tick."""
    command: Any = g1_low_cmd_t()
    command.header.utime = inputs.utime
    command.state_seq = inputs.state.header.seq if inputs.state is not None else 0
    command.valid_until_utime = inputs.utime + COMMAND_VALID_US
    command.mode = mode
    command.joint_pos_target = targets.joint_pos
    command.joint_vel_target = np.zeros(29, np.float32)
    command.joint_torque_ff = np.zeros(29, np.float32)
    command.joint_stiffness = targets.joint_stiffness
    command.joint_damping = targets.joint_damping
    return cast(g1_low_cmd_t, command)


def command_for(inputs: TickInput, targets: JointTargets | None, is_limp: bool) -> g1_low_cmd_t:
    """Return the command of a tick; without targets it is damping, or no torque at all."""
    if targets is not None:
        return make_command(inputs, g1_low_cmd_t.MODE_POSITION, targets)
    zeros = np.zeros(29, np.float32)
    if is_limp:
        targets = JointTargets(zeros, zeros, zeros)
        return make_command(inputs, g1_low_cmd_t.MODE_ZERO_TORQUE, targets)
    damping = np.full(29, DAMPING_GAIN, np.float32)
    return make_command(inputs, g1_low_cmd_t.MODE_DAMPING, JointTargets(zeros, zeros, damping))


def estop_text(estops: tuple[estop_t, ...]) -> str:
    """Return who asked for an emergency stop and why; empty: nobody."""
    for msg in estops:
        if msg.level != estop_t.CLEAR:
            return f"{msg.source or 'somebody'}: {msg.reason or 'no reason given'}"
    return ""
