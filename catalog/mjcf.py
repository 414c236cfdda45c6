"""Our own MJCF of the G1, written as text from the facts; nothing here imports MuJoCo.

Collision shapes are the facts' primitives with four spheres per sole: all five skills tried survive
30 s with them and with seven capsules per sole, and a step costs half as much. The solver settings
(pyramidal cone, implicitfast, Newton) are those of the skill generator, of the plant and of every
batch check: a capped or other solver invents falls. The automatic reset is off: it hides falls.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from downbeat.catalog.appearance import add_appearance
from downbeat.catalog.errors import CatalogError
from downbeat.catalog.robot import FACTS_PATH, Robot, load_facts, load_g1
from downbeat.catalog.stage import add_stage
from downbeat.runtime.errors import one_of

FLOOR = "floor"
TORSO = "torso_link"
VISUAL_GROUP = "1"
COLLISION_GROUP = "3"
"""MuJoCo shows groups 0 to 2 unless it is told otherwise."""
FOOT_CAPSULE_PREFIXES = ("left_foot", "right_foot")
IMU_SITES = ("imu_in_pelvis", "imu_in_torso")


@dataclass(frozen=True, slots=True)
class ModelOptions:
    """What may vary between models of the same robot.

    Attributes:
        timestep_s: Physics step; the generator and the batch checks use 5 ms, the plant 2 ms.
        friction: Sliding friction of soles and floor.
        mass_scale: Factor on mass and inertia of the torso (a payload).
        torso_offset_m: Shift of the torso's centre of mass forward.
        gain_scale: Factor on kp and kd.
        armature_scale: Factor on the rotor inertias.
        self_collision: Whether the robot's links collide with each other.
        visual: Add the looks: shells, stage, lights, cameras.
        show_collision: Show the collision shapes too (group 1 instead of 3).
        imu_sensors: Add gyro, accelerometer and orientation of both IMUs.
        mesh_dir: Folder with Unitree's STL files for a prettier picture; None: our own shells.
        offscreen_size_px: Largest picture the renderer may be asked for, width and height.
    """

    timestep_s: float = 0.005
    friction: float = 0.6
    mass_scale: float = 1.0
    torso_offset_m: float = 0.0
    gain_scale: float = 1.0
    armature_scale: float = 1.0
    self_collision: bool = True
    visual: bool = True
    show_collision: bool = False
    imu_sensors: bool = False
    mesh_dir: Path | None = None
    offscreen_size_px: tuple[int, int] = (1920, 1080)


def g1_mjcf(options: ModelOptions | None = None) -> str:
    """Return the model as MJCF text.

    qpos[7:] and the actuators are in Unitree motor order. The actuators are position servos with
    the robot's gains and torque limits: tau = kp (ctrl - q) - kd qd, clamped.

    Raises:
        CatalogError: `mesh_dir` lacks a file.
    """
    options = options or ModelOptions()
    robot = load_g1()
    root = ET.Element("mujoco", model="g1")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    solver = ET.SubElement(
        root,
        "option",
        timestep=repr(options.timestep_s),
        integrator="implicitfast",
        cone="pyramidal",
        solver="Newton",
    )
    ET.SubElement(solver, "flag", autoreset="disable")
    _add_meshes(root, options.mesh_dir)
    world = ET.SubElement(root, "worldbody")
    floor = ET.SubElement(
        world,
        "geom",
        name=FLOOR,
        type="plane",
        size="0 0 0.05",
        friction=_friction(options),
    )
    bodies = _add_bodies(world, robot, options)
    if options.visual:
        add_stage(root, world, floor, options.offscreen_size_px)
        if options.mesh_dir is None:
            add_appearance(root, bodies, VISUAL_GROUP)
        else:
            _add_mesh_geoms(bodies)
    _add_contact_excludes(root)
    _add_actuators(root, robot, options)
    if options.imu_sensors:
        _add_imu_sensors(root)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _numbers(values: Iterable[float]) -> str:
    """Return numbers as MJCF wants them, with all their digits."""
    return " ".join(repr(float(v)) for v in values)


def _friction(options: ModelOptions) -> str:
    return _numbers((options.friction, 0.005, 0.0001))


def _add_bodies(world: ET.Element, robot: Robot, options: ModelOptions) -> dict[str, ET.Element]:
    """Add the tree of bodies with joints, inertias, collision shapes and sites."""
    facts = load_facts()
    joints = {joint["body"]: joint for joint in facts["joints"]}
    armature = dict(zip(robot.joint_names, robot.joint_armature))
    bodies: dict[str, ET.Element] = {}
    for entry in facts["bodies"]:
        parent = bodies.get(entry["parent"], world)
        body = ET.SubElement(
            parent,
            "body",
            name=entry["name"],
            pos=_numbers(entry["pos"]),
            quat=_numbers(entry["quat"]),
        )
        bodies[entry["name"]] = body
        body.append(_inertial(entry, options))
        if parent is world:
            ET.SubElement(body, "freejoint", name="floating_base_joint")
        else:
            joint = joints[entry["name"]]
            ET.SubElement(
                body,
                "joint",
                name=joint["name"],
                type="hinge",
                axis=_numbers(joint["axis"]),
                range=_numbers(joint["range"]),
                armature=repr(float(armature[joint["name"]] * options.armature_scale)),
            )
    for shape in facts["collision_primitives_mjlab"]:
        if not shape["name"].startswith(FOOT_CAPSULE_PREFIXES):
            _add_link_shape(bodies[shape["body"]], shape, options)
    _add_soles(bodies, robot, options)
    for site in robot.sites:
        ET.SubElement(bodies[site.body], "site", name=site.name, pos=_numbers(site.pos), group="5")
    return bodies


def _inertial(entry: dict[str, Any], options: ModelOptions) -> ET.Element:
    """Return the body's inertia; the options change the torso's."""
    is_torso = entry["name"] == TORSO
    scale = options.mass_scale if is_torso else 1.0
    offset_m = options.torso_offset_m if is_torso else 0.0
    x, y, z = entry["ipos"]
    return ET.Element(
        "inertial",
        pos=_numbers((x + offset_m, y, z)),
        quat=_numbers(entry["iquat"]),
        mass=repr(float(entry["mass"] * scale)),
        diaginertia=_numbers(v * scale for v in entry["diaginertia"]),
    )


def _collision_look(options: ModelOptions) -> dict[str, str]:
    group = VISUAL_GROUP if options.show_collision else COLLISION_GROUP
    return {"group": group, "rgba": "0.55 0.6 0.7 1", "density": "0"}


def _add_link_shape(body: ET.Element, shape: dict[str, Any], options: ModelOptions) -> None:
    """Add a link's collision shape: no friction of its own, it should not touch the floor."""
    attributes = {
        "name": shape["name"],
        "type": shape["type"],
        "size": repr(float(shape["size"])),
        "condim": "1",
        **_collision_look(options),
    }
    for key in ("fromto", "pos"):
        if key in shape:
            attributes[key] = _numbers(shape[key])
    if not options.self_collision:
        attributes.update(contype="0", conaffinity="1")
    ET.SubElement(body, "geom", attributes)


def _add_soles(bodies: dict[str, ET.Element], robot: Robot, options: ModelOptions) -> None:
    """Add the contact spheres; their priority makes their friction the one that counts."""
    for side, body_name in zip(("left", "right"), robot.feet.body_names):
        for number, pos in enumerate(robot.feet.pos, start=1):
            attributes = {
                "name": f"{side}_foot{number}_collision",
                "type": "sphere",
                "size": repr(robot.feet.radius),
                "pos": _numbers(pos),
                "condim": "3",
                "priority": "1",
                "friction": _friction(options),
                **_collision_look(options),
            }
            if not options.self_collision:
                attributes.update(contype="0", conaffinity="1")
            ET.SubElement(bodies[body_name], "geom", attributes)


def _add_contact_excludes(root: ET.Element) -> None:
    contact = ET.SubElement(root, "contact")
    for first, second in load_facts()["contact_exclude_mjlab"]:
        ET.SubElement(contact, "exclude", body1=first, body2=second)


def _add_actuators(root: ET.Element, robot: Robot, options: ModelOptions) -> None:
    actuators = ET.SubElement(root, "actuator")
    for index, name in enumerate(robot.joint_names):
        stiffness = float(robot.joint_stiffness[index]) * options.gain_scale
        damping = float(robot.joint_damping[index]) * options.gain_scale
        limit = float(robot.effort_limit[index])
        ET.SubElement(
            actuators,
            "general",
            name=name,
            joint=name,
            gaintype="fixed",
            biastype="affine",
            gainprm=_numbers((stiffness,)),
            biasprm=_numbers((0.0, -stiffness, -damping)),
            forcerange=_numbers((-limit, limit)),
            ctrllimited="false",
        )


def _add_imu_sensors(root: ET.Element) -> None:
    sensors = ET.SubElement(root, "sensor")
    for site in IMU_SITES:
        ET.SubElement(sensors, "framequat", name=f"{site}_quat", objtype="site", objname=site)
        ET.SubElement(sensors, "gyro", name=f"{site}_gyro", site=site)
        ET.SubElement(sensors, "accelerometer", name=f"{site}_accel", site=site)


def _add_meshes(root: ET.Element, mesh_dir: Path | None) -> None:
    """Declare the STL files; they are only looked at, never collided with."""
    if mesh_dir is None:
        return
    entries = load_facts()["visual_meshes_optional"]
    missing = [m["file"] for m in entries if not (mesh_dir / m["file"]).is_file()]
    if missing:
        raise CatalogError(
            f"Mesh folder {mesh_dir} lacks {one_of(missing)}; it needs the STL files of the G1"
            f" rev 1.0, or leave mesh_dir out for the built-in shells"
            f" ({FACTS_PATH.name}: visual_meshes_optional)."
        )
    assets = ET.SubElement(root, "asset")
    for mesh in entries:
        file = str((mesh_dir / mesh["file"]).resolve())
        ET.SubElement(assets, "mesh", name=mesh["mesh"], file=file)


def _add_mesh_geoms(bodies: dict[str, ET.Element]) -> None:
    for mesh in load_facts()["visual_meshes_optional"]:
        ET.SubElement(
            bodies[mesh["body"]],
            "geom",
            type="mesh",
            mesh=mesh["mesh"],
            pos=_numbers(mesh.get("pos", (0.0, 0.0, 0.0))),
            quat=_numbers(mesh.get("quat", (1.0, 0.0, 0.0, 0.0))),
            rgba=_numbers((*mesh["rgb"], 1.0)),
            group=VISUAL_GROUP,
            contype="0",
            conaffinity="0",
            density="0",
        )
