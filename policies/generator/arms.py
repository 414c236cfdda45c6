"""Named arm poses. A pose is written for the left arm and mirrored for the right one.

A pose is (shoulder pitch, shoulder roll, shoulder yaw, elbow, wrist roll, wrist pitch, wrist yaw)
in rad; trailing zeros may be left out. Signs, left arm: pitch negative lifts forward, roll positive
lifts sideways; elbow 0 is a right angle, 1.5 nearly straight, -1 folded. Shoulder yaw turns the
forearm: inward when the arm hangs, up when it is abducted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from downbeat.policies.errors import PolicyError
from downbeat.runtime.errors import one_of

F64 = NDArray[np.float64]
Pose = str | tuple[float, ...]
ARM_JOINTS = 7
MIRROR = np.array([1.0, -1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # (7,) left -> right

POSES: dict[str, tuple[float, ...]] = {
    "stand": (0.2, 0.2, 0.0, 0.6),
    "down": (0.2, 0.2, 0.0, 1.0),
    "t": (0.0, 1.5, 0.0, 1.45),
    "v": (0.0, 2.2, 0.0, 1.4),
    "up": (-2.9, 0.4, 0.0, 1.4),
    "front": (-1.5, 0.1, 0.0, 1.3),
    "hip": (-0.1, 0.8, 0.45, -0.35),
    "low": (0.0, 0.75, 0.0, 1.4),
    "goal": (0.0, 1.45, 1.35, 0.05),
    "goal_down": (0.0, 1.45, -1.35, 0.05),
    "claw": (-0.75, 0.75, 0.95, -0.25),
    "claw_high": (-1.35, 0.75, 0.75, -0.35),
    "chest": (-0.7, 0.85, 0.0, -0.6),
    "guard": (-0.5, 0.35, 0.1, -0.7),
    "bent": (-0.15, 0.3, 0.0, -0.1),
    "bent_front": (-0.75, 0.3, -0.2, -0.15),
    "bent_back": (0.45, 0.3, 0.1, 0.1),
    "frame": (-0.35, 1.35, 0.2, 0.75),
    "hold": (-0.85, 0.75, -0.75, 0.05),
    "overhead": (-2.6, 0.75, -0.3, 0.3),
    "chop": (-1.7, 0.2, 0.0, 0.0),
    "chop_down": (-0.45, 0.2, 0.0, 0.3),
    "open": (-0.5, 1.15, 0.1, 0.7),
    "across": (-0.95, 0.3, -0.55, 0.35),
    "dab_out": (0.0, 1.95, 0.0, 1.4),
    "dab_in": (-1.45, 0.7, -0.55, -0.55),
}


def left_arm(pose: Pose) -> F64:
    """Return the left arm's joint angles (7,) [rad].

    Raises:
        PolicyError: No pose has this name, or the tuple is longer than an arm.
    """
    if isinstance(pose, str):
        if pose not in POSES:
            raise PolicyError(f"Arm pose '{pose}' is unknown; poses are {one_of(POSES)}.")
        pose = POSES[pose]
    if len(pose) > ARM_JOINTS:
        raise PolicyError(f"An arm pose has {len(pose)} numbers; an arm has {ARM_JOINTS} joints.")
    angles = np.zeros(ARM_JOINTS)
    angles[: len(pose)] = pose
    return angles


def right_arm(pose: Pose) -> F64:
    """Return the right arm's joint angles (7,) [rad]: the mirror image of `left_arm`."""
    return MIRROR * left_arm(pose)
