"""The fault table: what can go wrong, what control does about it, what it says.

Rows are reviewed as a table and tested one by one. The first matching row with the hardest
reaction wins; every row with reaction DAMPING or harder is latched until CLEAR_TRIP.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Reaction(IntEnum):
    """What control does, harder is larger."""

    NONE = 0
    """Report only."""
    DAMPING = 1
    """Joints are damped; latched."""
    ESTOP = 2
    """Emergency stop; latched."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One row.

    Attributes:
        id: Number on the wire (control_status_t.fault).
        name: Short name.
        reaction: What control does.
        raise_after_ticks: The condition must hold for this many ticks in a row.
        message: One sentence; `{}` takes the measured value.
    """

    id: int
    name: str
    reaction: Reaction
    raise_after_ticks: int
    message: str


ESTOP = Fault(1, "estop", Reaction.ESTOP, 1, "Emergency stop by {}.")
STATE_STALE = Fault(
    2, "state_stale", Reaction.DAMPING, 1, "G1_LOW_STATE is {} ms old, at most 100 are allowed."
)
NON_FINITE_OBSERVATION = Fault(
    3, "non_finite_observation", Reaction.DAMPING, 1, "The observation of {} is not finite."
)
NON_FINITE_ACTION = Fault(
    4, "non_finite_action", Reaction.DAMPING, 1, "The action of {} is not finite."
)
TILT = Fault(5, "tilt", Reaction.DAMPING, 3, "The pelvis is tilted by {} rad, limit 0.8.")
JOINT_RANGE = Fault(
    6, "joint_range", Reaction.DAMPING, 5, "Joint {} is outside its range by more than 0.15 rad."
)
JOINT_SPEED = Fault(
    7, "joint_speed", Reaction.DAMPING, 5, "Joint {} is faster than 1.2 times its limit."
)
MOTOR_FAULT = Fault(8, "motor_fault", Reaction.DAMPING, 5, "Motor {} reports a fault.")
STATE_LATE = Fault(9, "state_late", Reaction.NONE, 1, "G1_LOW_STATE is {} ms old.")
FAULTS: tuple[Fault, ...] = (
    ESTOP,
    STATE_STALE,
    NON_FINITE_OBSERVATION,
    NON_FINITE_ACTION,
    TILT,
    JOINT_RANGE,
    JOINT_SPEED,
    MOTOR_FAULT,
    STATE_LATE,
)
"""Every fault that control knows."""
