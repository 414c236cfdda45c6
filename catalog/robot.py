"""The robot: a Unitree G1 with 29 joints, read from catalog/g1_facts.json."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.errors import CatalogError
from downbeat.runtime.errors import one_of

FACTS_PATH = Path(__file__).with_name("g1_facts.json")
NUM_JOINTS = 29
STAND_KEYFRAME = "knees_bent"
"""The facts' keyframe that is our default pose (BeyondMimic's, too)."""
GAINS = "beyondmimic_mjlab"
"""kp = armature w^2, kd = 2 zeta armature w with w = 2 pi 10 Hz, zeta = 2."""

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Site:
    """A named point on a body, `pos` (3,) [m] in the body's frame."""

    name: str
    body: str
    pos: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class FootSpheres:
    """The contact points of one sole.

    Attributes:
        body_names: The left and the right foot body.
        radius: [m] of each sphere.
        pos: Centres in the foot's frame, four times (3,) [m].
    """

    body_names: tuple[str, str]
    radius: float
    pos: tuple[tuple[float, float, float], ...]

    @property
    def sole_z(self) -> float:
        """Height of the sole in the foot's frame [m]."""
        return min(p[2] for p in self.pos) - self.radius


@dataclass(frozen=True, eq=False)
class Robot:
    """What everybody above needs to know about the robot. Arrays are read-only, motor order.

    Attributes:
        name: Model and revision.
        joint_names: 29 names in Unitree motor order.
        joint_stiffness: (29,) [N m/rad] kp.
        joint_damping: (29,) [N m s/rad] kd.
        joint_armature: (29,) [kg m^2] reflected rotor inertia.
        effort_limit: (29,) [N m].
        velocity_limit: (29,) [rad/s].
        joint_range: (29, 2) [rad] low, high.
        default_joint_pos: (29,) [rad] the stand pose.
        action_scale: (29,) [rad] 0.25 effort / kp.
        total_mass: [kg].
        body_names: 30 names, parents before children; the first is the base.
        sites: IMUs, soles and palms.
        feet: Contact points of the soles.
    """

    name: str
    joint_names: tuple[str, ...]
    joint_stiffness: F64
    joint_damping: F64
    joint_armature: F64
    effort_limit: F64
    velocity_limit: F64
    joint_range: F64
    default_joint_pos: F64
    action_scale: F64
    total_mass: float
    body_names: tuple[str, ...]
    sites: tuple[Site, ...]
    feet: FootSpheres

    def joint_index(self, name: str) -> int:
        """Return the motor index of a joint; the ending `_joint` may be left out.

        Raises:
            CatalogError: There is no such joint.
        """
        full = name if name.endswith("_joint") else f"{name}_joint"
        if full not in self.joint_names:
            raise CatalogError(
                f"Joint '{name}' is unknown; joints are {one_of(self.joint_names)}"
                f" ({FACTS_PATH.name}: joints)."
            )
        return self.joint_names.index(full)

    def site(self, name: str) -> Site:
        """Return a site by name.

        Raises:
            CatalogError: There is no such site.
        """
        for site in self.sites:
            if site.name == name:
                return site
        raise CatalogError(
            f"Site '{name}' is unknown; sites are {one_of(s.name for s in self.sites)}"
            f" ({FACTS_PATH.name}: sites)."
        )


@cache
def load_facts() -> dict[str, Any]:
    """Return the parsed facts file; callers must not change it.

    Raises:
        CatalogError: The file is missing or not JSON.
    """
    try:
        facts: dict[str, Any] = json.loads(FACTS_PATH.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CatalogError(
            f"The robot's facts cannot be read: {error}; the file belongs to the installation"
            f" ({FACTS_PATH})."
        ) from error
    return facts


@cache
def load_g1() -> Robot:
    """Return the G1; built once, shared.

    Raises:
        CatalogError: The facts contradict each other.
    """
    facts = load_facts()
    joints = facts["joints"]
    names = tuple(str(joint["name"]) for joint in joints)
    if list(names) != facts["orders"]["motor_mujoco"] or len(names) != NUM_JOINTS:
        raise CatalogError(
            f"The joints are not the {NUM_JOINTS} motors in motor order"
            f" ({FACTS_PATH.name}: joints, orders.motor_mujoco)."
        )
    feet = facts["feet"]
    spheres = feet["unitree_4_spheres"]
    keyframe = facts["keyframes"][STAND_KEYFRAME]
    return Robot(
        name=facts["robot"],
        joint_names=names,
        joint_stiffness=_column([joint["gains"][GAINS]["kp"] for joint in joints]),
        joint_damping=_column([joint["gains"][GAINS]["kd"] for joint in joints]),
        joint_armature=_column([joint["armature"] for joint in joints]),
        effort_limit=_column([joint["effort_limit_nm"] for joint in joints]),
        velocity_limit=_column([joint["velocity_limit_rad_s"] for joint in joints]),
        joint_range=_column([joint["range"] for joint in joints]),
        default_joint_pos=_column(keyframe["joint_pos"]),
        action_scale=_column([joint["gains"][GAINS]["action_scale"] for joint in joints]),
        total_mass=float(facts["total_mass"]),
        body_names=tuple(str(body["name"]) for body in facts["bodies"]),
        sites=tuple(Site(s["name"], s["body"], _point(s["pos"])) for s in facts["sites"]),
        feet=FootSpheres(
            body_names=(feet["per_foot_body"][0], feet["per_foot_body"][1]),
            radius=float(spheres["radius"]),
            pos=tuple(_point(p) for p in spheres["pos"]),
        ),
    )


def _column(values: list[Any]) -> F64:
    """Return a read-only array: everybody shares it."""
    array = np.asarray(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def _point(values: list[float]) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))
