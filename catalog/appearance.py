"""How the robot looks: shells over dark joints. Nothing here touches the physics.

Shells are lofts: elliptic rings along one axis, closed by MuJoCo into their convex hull. Everything
is written for the left side and the middle; the right side is its mirror image.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

SHELL, DARK, ACCENT, VISOR = "shell", "dark", "accent", "visor"
RING_POINTS = 20

Point = tuple[float, float, float]
Ring = tuple[float, float, float, float, float]
"""Along the axis, centre and half width across it: (s, centre_1, centre_2, half_1, half_2).

The two directions across are x, y for axis z, and y, z for axis x. [m]
"""


@dataclass(frozen=True, slots=True)
class Loft:
    """A shell through rings along `axis`; `squareness` 2 is an ellipse, more is boxier."""

    body: str
    name: str
    material: str
    axis: str
    rings: tuple[Ring, ...]
    squareness: float = 2.4


@dataclass(frozen=True, slots=True)
class Rod:
    """A capsule between two points."""

    body: str
    material: str
    start: Point
    end: Point
    radius: float


@dataclass(frozen=True, slots=True)
class Ball:
    """An ellipsoid."""

    body: str
    material: str
    pos: Point
    half_size: Point


MIDDLE: tuple[Loft | Rod | Ball, ...] = (
    Loft(
        "pelvis",
        "hips",
        DARK,
        "z",
        (
            (-0.165, 0.0, 0.0, 0.040, 0.035),
            (-0.125, 0.0, 0.0, 0.062, 0.060),
            (-0.060, 0.0, 0.0, 0.070, 0.082),
            (-0.010, 0.0, 0.0, 0.060, 0.075),
        ),
    ),
    Loft(
        "pelvis",
        "belt",
        SHELL,
        "z",
        ((-0.070, 0.004, 0.0, 0.072, 0.086), (-0.030, 0.004, 0.0, 0.074, 0.090)),
    ),
    Rod("waist_yaw_link", DARK, (0.0, 0.0, 0.0), (0.0, 0.0, 0.045), 0.048),
    Loft(
        "torso_link",
        "abdomen",
        DARK,
        "z",
        (
            (0.000, 0.0, 0.0, 0.050, 0.060),
            (0.060, 0.004, 0.0, 0.066, 0.080),
            (0.130, 0.004, 0.0, 0.076, 0.094),
        ),
    ),
    Loft(
        "torso_link",
        "chest",
        SHELL,
        "z",
        (
            (0.085, 0.012, 0.0, 0.066, 0.080),
            (0.130, 0.012, 0.0, 0.083, 0.102),
            (0.215, 0.008, 0.0, 0.090, 0.116),
            (0.275, 0.002, 0.0, 0.076, 0.104),
            (0.312, -0.004, 0.0, 0.044, 0.060),
        ),
        2.8,
    ),
    Loft(
        "torso_link",
        "pack",
        DARK,
        "z",
        (
            (0.080, -0.060, 0.0, 0.030, 0.060),
            (0.160, -0.072, 0.0, 0.036, 0.078),
            (0.260, -0.062, 0.0, 0.032, 0.070),
        ),
        3.2,
    ),
    Ball("torso_link", ACCENT, (0.093, 0.0, 0.212), (0.010, 0.022, 0.022)),
    Ball("torso_link", DARK, (0.089, 0.0, 0.212), (0.012, 0.030, 0.030)),
    Rod("torso_link", DARK, (-0.004, 0.0, 0.300), (0.0, 0.0, 0.360), 0.034),
    Loft(
        "torso_link",
        "head",
        SHELL,
        "z",
        (
            (0.352, 0.004, 0.0, 0.030, 0.030),
            (0.372, 0.004, 0.0, 0.054, 0.050),
            (0.420, 0.0, 0.0, 0.072, 0.063),
            (0.462, -0.004, 0.0, 0.066, 0.059),
            (0.488, -0.008, 0.0, 0.046, 0.042),
            (0.499, -0.010, 0.0, 0.020, 0.018),
        ),
    ),
    Ball("torso_link", VISOR, (0.026, 0.0, 0.428), (0.055, 0.057, 0.042)),
    Rod("torso_link", ACCENT, (0.079, -0.016, 0.431), (0.079, 0.016, 0.431), 0.0045),
)

LEFT: tuple[Loft | Rod | Ball, ...] = (
    Ball("left_hip_pitch_link", DARK, (0.0, 0.030, -0.012), (0.052, 0.050, 0.052)),
    Loft(
        "left_hip_roll_link",
        "hip",
        SHELL,
        "z",
        (
            (0.040, 0.008, 0.002, 0.034, 0.030),
            (0.010, 0.014, 0.002, 0.058, 0.052),
            (-0.060, 0.020, 0.0, 0.064, 0.058),
            (-0.115, 0.022, 0.0, 0.058, 0.053),
        ),
    ),
    Loft(
        "left_hip_yaw_link",
        "thigh",
        SHELL,
        "z",
        (
            (-0.008, -0.002, 0.0, 0.058, 0.053),
            (-0.060, -0.020, 0.0, 0.062, 0.056),
            (-0.120, -0.050, 0.0, 0.054, 0.050),
            (-0.165, -0.072, 0.001, 0.042, 0.042),
        ),
    ),
    Rod("left_hip_yaw_link", DARK, (0.024, 0.0, 0.004), (0.018, 0.0, -0.004), 0.050),
    Rod("left_knee_link", DARK, (0.0, -0.026, 0.0), (0.0, 0.026, 0.0), 0.040),
    Ball("left_knee_link", ACCENT, (0.0, 0.062, 0.0), (0.016, 0.007, 0.016)),
    Loft(
        "left_knee_link",
        "shin",
        SHELL,
        "z",
        (
            (0.022, 0.030, 0.0, 0.014, 0.024),
            (-0.030, 0.016, 0.0, 0.040, 0.038),
            (-0.100, 0.008, 0.0, 0.047, 0.043),
            (-0.190, 0.006, 0.0, 0.038, 0.035),
            (-0.262, 0.004, 0.0, 0.027, 0.026),
        ),
    ),
    Rod("left_knee_link", DARK, (-0.022, 0.0, -0.070), (-0.010, 0.0, -0.255), 0.026),
    Rod("left_ankle_pitch_link", DARK, (0.0, -0.012, 0.0), (0.0, 0.012, 0.0), 0.029),
    Loft(
        "left_ankle_roll_link",
        "shoe",
        SHELL,
        "x",
        (
            (-0.066, 0.0, -0.016, 0.020, 0.012),
            (-0.048, 0.0, -0.008, 0.031, 0.022),
            (0.010, 0.0, -0.003, 0.034, 0.028),
            (0.075, 0.0, -0.014, 0.037, 0.018),
            (0.122, 0.0, -0.020, 0.031, 0.011),
            (0.140, 0.0, -0.023, 0.016, 0.006),
        ),
        3.0,
    ),
    Loft(
        "left_ankle_roll_link",
        "sole",
        DARK,
        "z",
        ((-0.0345, 0.036, 0.0, 0.100, 0.033), (-0.0240, 0.037, 0.0, 0.106, 0.038)),
        3.4,
    ),
    Ball("left_shoulder_pitch_link", DARK, (0.0, 0.026, -0.006), (0.046, 0.040, 0.046)),
    Loft(
        "left_shoulder_roll_link",
        "shoulder",
        SHELL,
        "z",
        (
            (0.048, 0.0, 0.0, 0.022, 0.020),
            (0.034, 0.0, 0.002, 0.042, 0.038),
            (0.000, 0.0, 0.005, 0.053, 0.048),
            (-0.050, 0.0, 0.006, 0.047, 0.044),
            (-0.085, 0.0, 0.006, 0.037, 0.036),
        ),
    ),
    Rod("left_shoulder_yaw_link", DARK, (0.0, 0.0, 0.020), (0.0, 0.0, -0.010), 0.032),
    Loft(
        "left_shoulder_yaw_link",
        "arm",
        SHELL,
        "z",
        (
            (-0.002, 0.0, 0.0, 0.038, 0.037),
            (-0.045, 0.006, 0.0, 0.036, 0.034),
            (-0.068, 0.010, 0.0, 0.027, 0.027),
        ),
    ),
    Rod("left_elbow_link", DARK, (0.0, -0.022, 0.0), (0.0, 0.022, 0.0), 0.032),
    Ball("left_elbow_link", ACCENT, (0.0, 0.053, 0.0), (0.012, 0.005, 0.012)),
    Loft(
        "left_elbow_link",
        "forearm",
        SHELL,
        "x",
        (
            (0.012, 0.0, -0.004, 0.026, 0.026),
            (0.045, 0.001, -0.008, 0.037, 0.037),
            (0.100, 0.002, -0.010, 0.030, 0.030),
        ),
    ),
    Rod("left_wrist_roll_link", DARK, (-0.004, 0.0, 0.0), (0.030, 0.0, 0.0), 0.025),
    Loft(
        "left_wrist_pitch_link",
        "wrist",
        SHELL,
        "x",
        (
            (-0.018, 0.0, 0.0, 0.025, 0.025),
            (0.010, 0.0, 0.0, 0.031, 0.031),
            (0.044, 0.0, 0.0, 0.024, 0.026),
        ),
    ),
    Loft(
        "left_wrist_yaw_link",
        "palm",
        DARK,
        "x",
        (
            (-0.002, 0.0, 0.0, 0.020, 0.022),
            (0.050, 0.0, 0.0, 0.019, 0.036),
            (0.085, -0.002, 0.0, 0.015, 0.036),
        ),
        3.0,
    ),
    Rod("left_wrist_yaw_link", DARK, (0.088, -0.002, 0.026), (0.128, -0.012, 0.028), 0.0095),
    Rod("left_wrist_yaw_link", DARK, (0.088, -0.002, 0.004), (0.136, -0.014, 0.004), 0.0095),
    Rod("left_wrist_yaw_link", DARK, (0.088, -0.002, -0.018), (0.130, -0.012, -0.020), 0.0095),
    Rod("left_wrist_yaw_link", DARK, (0.050, -0.016, 0.030), (0.078, -0.038, 0.036), 0.0095),
)


def add_appearance(root: ET.Element, bodies: dict[str, ET.Element], group: str) -> None:
    """Add the robot's shells to its bodies."""
    assets = ET.SubElement(root, "asset")
    _add_materials(assets)
    for part in MIDDLE:
        _add_part(assets, bodies, part, part.body, group, mirror=1.0)
    for part in LEFT:
        _add_part(assets, bodies, part, part.body, group, mirror=1.0)
        right = part.body.replace("left_", "right_")
        _add_part(assets, bodies, part, right, group, mirror=-1.0)


def _add_materials(assets: ET.Element) -> None:
    looks = {
        SHELL: {"rgba": "0.93 0.93 0.95 1", "specular": "0.5", "shininess": "0.6"},
        DARK: {"rgba": "0.10 0.11 0.13 1", "specular": "0.35", "shininess": "0.4"},
        VISOR: {"rgba": "0.02 0.02 0.03 1", "specular": "1", "shininess": "0.95"},
        ACCENT: {"rgba": "0.10 0.85 0.95 1", "emission": "0.9", "specular": "0.2"},
    }
    for name, look in looks.items():
        ET.SubElement(assets, "material", {"name": name, **look})


def _add_part(
    assets: ET.Element,
    bodies: dict[str, ET.Element],
    part: Loft | Rod | Ball,
    body: str,
    group: str,
    mirror: float,
) -> None:
    """Add one part; `mirror` -1 turns the left side into the right one (y becomes -y)."""
    geom = ET.SubElement(
        bodies[body],
        "geom",
        material=part.material,
        group=group,
        contype="0",
        conaffinity="0",
        density="0",
    )
    if isinstance(part, Ball):
        x, y, z = part.pos
        geom.attrib.update(
            type="ellipsoid", pos=_text((x, y * mirror, z)), size=_text(part.half_size)
        )
    elif isinstance(part, Rod):
        ends = (*part.start, *part.end)
        mirrored = (ends[0], ends[1] * mirror, ends[2], ends[3], ends[4] * mirror, ends[5])
        geom.attrib.update(type="capsule", fromto=_text(mirrored), size=_text((part.radius,)))
    else:
        name = f"{body}_{part.name}"
        vertices = [c for x, y, z in loft_points(part) for c in (x, y * mirror, z)]
        ET.SubElement(assets, "mesh", name=name, vertex=_text(vertices))
        geom.attrib.update(type="mesh", mesh=name)


def loft_points(loft: Loft) -> list[Point]:
    """Return the points of all rings [m], body frame; superellipses, so that they may be boxy."""
    points = []
    exponent = 2.0 / loft.squareness
    for along, centre_1, centre_2, half_1, half_2 in loft.rings:
        for k in range(RING_POINTS):
            angle = 2.0 * math.pi * k / RING_POINTS
            c, s = math.cos(angle), math.sin(angle)
            first = centre_1 + half_1 * math.copysign(abs(c) ** exponent, c)
            second = centre_2 + half_2 * math.copysign(abs(s) ** exponent, s)
            if loft.axis == "z":
                points.append((first, second, along))
            else:
                points.append((along, first, second))
    return points


def _text(values: tuple[float, ...] | list[float]) -> str:
    return " ".join(f"{v:.6g}" for v in values)
