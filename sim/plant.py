"""The plant: a G1 in MuJoCo behind the motor interface of the real one.

Pure simulation: no bus, no clock. The motor law tau = ff + kp (q* - q) + kd (qd* - qd) runs inside
MuJoCo's actuators, whose gains are rewritten with every command: the torque limit then holds for
the whole sum, and implicitfast integrates the damping implicitly, as it did for the skills.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.mjcf import IMU_SITES, ModelOptions, g1_mjcf
from downbeat.catalog.robot import NUM_JOINTS, load_g1
from downbeat.lcm_types import g1_low_cmd_t
from downbeat.sim.errors import SimError
from downbeat.sim.gantry import Gantry, settle
from downbeat.sim.noise import NoiseConfig

F64 = NDArray[np.float64]

log = logging.getLogger("downbeat.sim")

EXPIRED_DAMPING = 2.0
"""[N m s/rad] of every joint once commands have expired: the robot sinks slowly."""
MAX_AHEAD_US = 1_000_000
"""A command stamped further ahead than this is on another time base."""

_JOINT_FIELDS = (
    "joint_pos_target",
    "joint_vel_target",
    "joint_torque_ff",
    "joint_stiffness",
    "joint_damping",
)


@dataclass(frozen=True, slots=True)
class PlantConfig:
    """Settings of the plant.

    Attributes:
        timestep_s: Physics step.
        friction: Of soles and floor.
        mass_scale: Factor on the torso's mass.
        noise: Of the sensors.
        command_delay_us: From the stamp of a command to its effect on the motors, at least; what
            a real robot loses on the wire and in its motor drives.
        start: "held": a gantry keeps the robot in the stand pose until the first position command,
            then lets go; "free": it stands in the stand pose on its own.
        release_s: How long the gantry takes to let go.
        seed: Of the noise.
    """

    timestep_s: float = 0.002
    friction: float = 0.6
    mass_scale: float = 1.0
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    command_delay_us: int = 4_000
    start: Literal["held", "free"] = "held"
    release_s: float = 0.5
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Command:
    """A motor command as the plant keeps it; arrays (29,) float64, motor order."""

    effect_utime: int
    valid_until_utime: int
    mode: int
    joint_pos_target: F64
    joint_vel_target: F64
    joint_torque_ff: F64
    joint_stiffness: F64
    joint_damping: F64


@dataclass(slots=True)
class PlantCounters:
    """What happened to commands."""

    accepted: int = 0
    refused: int = 0
    expired: int = 0


class Plant:
    """One robot. `step` integrates one timestep; everything else reads or writes its inputs."""

    def __init__(self, config: PlantConfig | None = None) -> None:
        """Build the model and put the robot on its feet.

        Raises:
            SimError: A setting is impossible.
        """
        self.config = config or PlantConfig()
        _check(self.config)
        # MuJoCo would write MUJOCO_LOG.TXT into whatever folder we were started in.
        mujoco.set_mju_user_warning(log.warning)
        options = ModelOptions(
            timestep_s=self.config.timestep_s,
            friction=self.config.friction,
            mass_scale=self.config.mass_scale,
            visual=False,
            imu_sensors=True,
        )
        self.model: Any = mujoco.MjModel.from_xml_string(g1_mjcf(options))
        self.data: Any = mujoco.MjData(self.model)
        self.step_us = round(self.config.timestep_s * 1e6)
        self.steps = 0
        self.counters = PlantCounters()
        self.diverged = False
        self._pending: deque[Command] = deque()
        self._active: Command | None = None
        settle(self.model, self.data, load_g1().default_joint_pos)
        self.gantry = Gantry(self.data, self.config.release_s)
        if self.config.start == "free":
            self.gantry.vanish()
        self._apply_zero_torque()
        self._imu_addresses = [self._imu_address(site) for site in IMU_SITES]
        self._sole_of_geom = _soles(self.model)

    # ------------------------------------------------------------------ commands

    def command(self, msg: g1_low_cmd_t, utime: int) -> bool:
        """Take a command; it acts `command_delay_us` after its stamp.

        Args:
            msg: The decoded message.
            utime: Now [us].

        Returns:
            False if it was refused: a number is not finite, a gain is negative, or its stamp is
            on another time base. Nothing changes then but a counter.
        """
        columns = [np.asarray(getattr(msg, name), dtype=np.float64) for name in _JOINT_FIELDS]
        ok = all(c.shape == (NUM_JOINTS,) and bool(np.isfinite(c).all()) for c in columns)
        ok = ok and columns[3].min() >= 0.0 and columns[4].min() >= 0.0
        ok = ok and abs(msg.header.utime - utime) <= MAX_AHEAD_US
        if not ok:
            self.counters.refused += 1
            return False
        self.counters.accepted += 1
        effect_utime = msg.header.utime + self.config.command_delay_us
        self._pending.append(Command(effect_utime, msg.valid_until_utime, msg.mode, *columns))
        return True

    def _take_due(self, utime: int) -> None:
        """Make the newest due command the active one, or drop the active one when it is stale."""
        due = None
        while self._pending and self._pending[0].effect_utime <= utime:
            due = self._pending.popleft()
        if due is not None:
            self._active = due
            self._apply(due)
        if self._active is not None and self._active.valid_until_utime <= utime:
            self._active = None
            self.counters.expired += 1
            self._apply_damping(np.full(NUM_JOINTS, EXPIRED_DAMPING))

    @property
    def mode(self) -> int:
        """g1_low_cmd_t.MODE_* that the motors are in."""
        if self._active is not None:
            return self._active.mode
        if self.counters.expired:
            return int(g1_low_cmd_t.MODE_DAMPING)
        return int(g1_low_cmd_t.MODE_ZERO_TORQUE)

    def _apply(self, command: Command) -> None:
        if command.mode == g1_low_cmd_t.MODE_POSITION:
            bias = command.joint_torque_ff + command.joint_damping * command.joint_vel_target
            self.gantry.release()
            self._write_gains(command.joint_stiffness, command.joint_damping, bias)
            self.data.ctrl[:] = command.joint_pos_target
        elif command.mode == g1_low_cmd_t.MODE_DAMPING:
            self._apply_damping(command.joint_damping)
        else:
            self._apply_zero_torque()

    def _apply_damping(self, damping: F64) -> None:
        zeros = np.zeros(NUM_JOINTS)
        self._write_gains(zeros, damping, zeros)

    def _apply_zero_torque(self) -> None:
        zeros = np.zeros(NUM_JOINTS)
        self._write_gains(zeros, zeros, zeros)

    def _write_gains(self, stiffness: F64, damping: F64, bias: F64) -> None:
        """Write the motor law: force = gain ctrl + bias0 + bias1 q + bias2 qd."""
        model = self.model
        model.actuator_gainprm[:, 0] = stiffness
        model.actuator_biasprm[:, 0] = bias
        model.actuator_biasprm[:, 1] = -stiffness
        model.actuator_biasprm[:, 2] = -damping

    # ------------------------------------------------------------------ physics

    def step(self, utime: int) -> None:
        """Integrate one timestep that begins at `utime` [us]."""
        self._take_due(utime)
        self.steps += 1
        if self.gantry.is_holding or self.diverged:
            return
        data = self.data
        self.gantry.apply(self.model, data, self.config.timestep_s)
        mujoco.mj_step2(self.model, data)
        if not math.isfinite(float(data.qacc.sum())) or not math.isfinite(float(data.qpos.sum())):
            self.diverged = True
            return
        # Positions, velocities and their sensors now belong to the new state.
        mujoco.mj_step1(self.model, data)

    # ------------------------------------------------------------------ measurement

    @property
    def joint_pos(self) -> F64:
        """(29,) [rad] true."""
        return self.data.qpos[7:]

    @property
    def joint_vel(self) -> F64:
        """(29,) [rad/s] true."""
        return self.data.qvel[6:]

    @property
    def joint_torque(self) -> F64:
        """(29,) [N m] of the last step."""
        return self.data.actuator_force

    def imu(self, index: int) -> tuple[F64, F64, F64]:
        """Return orientation wxyz (4,), gyro (3,) [rad/s] and specific force (3,) [m/s^2].

        Args:
            index: 0 pelvis, 1 torso. The specific force is that of the last step.
        """
        quat, gyro, accel = self._imu_addresses[index]
        sensors = self.data.sensordata
        return sensors[quat : quat + 4], sensors[gyro : gyro + 3], sensors[accel : accel + 3]

    def _imu_address(self, site: str) -> tuple[int, int, int]:
        return tuple(
            int(self.model.sensor(f"{site}_{kind}").adr[0]) for kind in ("quat", "gyro", "accel")
        )

    def contact_force(self) -> F64:
        """Return the vertical ground force on the left and the right foot, (2,) [N]."""
        total = np.zeros(2)
        wrench = np.zeros(6)
        for index in range(self.data.ncon):
            contact = self.data.contact[index]
            for geom in contact.geom:
                side = self._sole_of_geom.get(int(geom))
                if side is not None and contact.efc_address >= 0:
                    mujoco.mj_contactForce(self.model, self.data, index, wrench)
                    total[side] += wrench[0] * abs(contact.frame[2])
        return total

    @property
    def base_height(self) -> float:
        """Of the pelvis above the floor [m]."""
        return float(self.data.qpos[2])


def _soles(model: Any) -> dict[int, int]:
    """Return geom id -> 0 left, 1 right for the contact spheres."""
    soles = {}
    for index in range(model.ngeom):
        name = model.geom(index).name
        for side, prefix in enumerate(("left_foot", "right_foot")):
            if name.startswith(prefix):
                soles[index] = side
    return soles


def _check(config: PlantConfig) -> None:
    if not 0.0005 <= config.timestep_s <= 0.005 or round(config.timestep_s * 1e6) % 500:
        raise SimError(
            f"A physics step of {config.timestep_s} s is not possible; valid are 0.0005 to 0.005 s"
            " in steps of 0.0005 s (PlantConfig: timestep_s)."
        )
    if config.command_delay_us < 0:
        raise SimError(
            f"A command delay of {config.command_delay_us} us is not possible; it must be 0 or"
            " more (PlantConfig: command_delay_us)."
        )
