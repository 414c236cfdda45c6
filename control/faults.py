"""The fault table: what can go wrong, what control does about it, what it says.

Rows are reviewed as a table and tested one by one; names are raised by `control/safety.py`. The
hardest raised reaction wins. DAMPING and ESTOP are latched until CLEAR_TRIP.
"""

from __future__ import annotations

from enum import IntEnum

from downbeat.runtime.faults import Fault, FaultTable


class Reaction(IntEnum):
    """What control does, harder is larger."""

    NONE = 0
    """Report only."""
    STAND = 1
    """End the skill the normal way, stand, and refuse skills while the fault lasts."""
    FALLBACK = 2
    """Drop the skill at once: the balance policy takes over in the same tick."""
    DAMPING = 3
    """Joints are damped; latched."""
    ESTOP = 4
    """Emergency stop; latched."""


TICKS_PER_S = 50

STATE_FAULTS: FaultTable[Reaction] = FaultTable(
    (
        Fault(1, "estop", Reaction.ESTOP, "Emergency stop by {}."),
        Fault(
            2,
            "state_stale",
            Reaction.DAMPING,
            "G1_LOW_STATE is {} ms old, at most 70 are allowed.",
        ),
        Fault(5, "tilt", Reaction.DAMPING, "The pelvis is tilted by {} rad.", raise_after_ticks=3),
        Fault(
            6,
            "joint_range",
            Reaction.DAMPING,
            "Joint {} is outside its range by more than the skill may.",
            raise_after_ticks=5,
        ),
        Fault(
            7,
            "joint_speed",
            Reaction.DAMPING,
            "Joint {} is faster than the skill may be.",
            raise_after_ticks=5,
        ),
        Fault(8, "motor_fault", Reaction.DAMPING, "Motor {} reports a fault.", raise_after_ticks=5),
        Fault(9, "state_late", Reaction.NONE, "G1_LOW_STATE is {} ms old."),
        Fault(
            11,
            "falling",
            Reaction.FALLBACK,
            "A fall is coming: {}.",
        ),
        Fault(
            12,
            "torque_saturated",
            Reaction.STAND,
            "Joint {} has been at its torque limit for too long.",
            clear_after_ticks=TICKS_PER_S,
        ),
        Fault(
            13,
            "motor_warm",
            Reaction.STAND,
            "Motor {} is warm.",
            raise_after_ticks=TICKS_PER_S,
            clear_after_ticks=10 * TICKS_PER_S,
        ),
        Fault(14, "motor_hot", Reaction.DAMPING, "Motor {} is hot.", raise_after_ticks=25),
        Fault(
            15,
            "battery_low",
            Reaction.STAND,
            "The battery is at {} %.",
            raise_after_ticks=TICKS_PER_S,
            clear_after_ticks=10 * TICKS_PER_S,
        ),
        Fault(
            16,
            "battery_empty",
            Reaction.DAMPING,
            "The battery is at {} %.",
            raise_after_ticks=TICKS_PER_S,
        ),
        Fault(17, "clock_step", Reaction.DAMPING, "Control's time stepped by {} ms."),
        Fault(
            18,
            "state_ahead",
            Reaction.DAMPING,
            "G1_LOW_STATE is stamped {} ms ahead of control's time.",
            raise_after_ticks=3,
        ),
        Fault(
            19,
            "second_publisher",
            Reaction.DAMPING,
            "A second publisher is on G1_LOW_STATE ({} messages).",
            raise_after_ticks=5,
            clear_after_ticks=TICKS_PER_S,
        ),
        Fault(
            22,
            "state_frozen",
            Reaction.DAMPING,
            "States arrive, but no number in them changes.",
            raise_after_ticks=8,
        ),
        Fault(
            20,
            "remote_lost",
            Reaction.DAMPING,
            "The remote has not been heard for {} s.",
        ),
    )
)
"""Judged before the skills run."""

POLICY_FAULTS: FaultTable[Reaction] = FaultTable(
    (
        Fault(
            3,
            "non_finite_observation",
            Reaction.FALLBACK,
            "The observation of {} is not finite.",
        ),
        Fault(4, "non_finite_action", Reaction.FALLBACK, "The action of {} is not finite."),
        Fault(
            10,
            "action_range",
            Reaction.FALLBACK,
            "The action of {} asks for a target that no motor can follow.",
        ),
        Fault(
            21,
            "fallback_failed",
            Reaction.DAMPING,
            "The balance policy cannot take over: {}.",
        ),
    )
)
"""Judged on what the skills computed, before anything is sent."""

FAULTS: tuple[Fault[Reaction], ...] = (*STATE_FAULTS, *POLICY_FAULTS)
"""Every fault that control knows."""
