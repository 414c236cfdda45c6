"""The steps between silence and a standing robot."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum


class Stage(IntEnum):
    """Where the bridge is."""

    CHECKING = 0
    """Silent: is this our robot, does it report, is the remote there, does nobody command it?"""
    RELEASING = 1
    """Silent: the robot's own motion service is being released."""
    ZERO_TORQUE = 2
    DAMPING = 3
    TO_POSE = 4
    """From the measured pose to the stand pose, then holding it."""
    HANDOVER = 5
    """Holding the pose until control's first position command."""
    ACTIVE = 6
    """Control's commands go to the motors."""
    TRIPPED = 7
    """Damping, until the operator clears it."""
    LEAVING = 8
    """Damping, until the time is over."""


SILENT = (Stage.CHECKING, Stage.RELEASING)
NEXT = {
    Stage.RELEASING: "release the robot's own motion service (hang the robot first)",
    Stage.ZERO_TORQUE: "go to damping",
    Stage.DAMPING: "move to the stand pose",
    Stage.TO_POSE: "hand over to control: it stands",
}
"""What the operator's confirmation leads to."""


@dataclass(slots=True)
class Outbox:
    """What the core wants published on LCM, taken by the node.

    Attributes:
        operator: operator_command_t constants.
        estops: Reasons of emergency stops.
    """

    operator: list[int] = field(default_factory=list)
    estops: list[str] = field(default_factory=list)
