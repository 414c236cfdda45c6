"""A G1 as its DDS messages show it: our plant behind LowCmd and LowState bytes.

No bus and no clock. What a test or an operator does to it (a button, a hot motor, a broken
checksum) is a word; `do` takes them.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from downbeat.control.bridge.crc import crc32_words
from downbeat.control.bridge.layout import (
    CDR_HEAD,
    CMD_BYTES,
    STATE_BYTES,
    STATE_CRC,
    STATE_FIRST_MOTOR,
    STATE_MOTOR,
    STATE_REMOTE,
    state_image,
)
from downbeat.control.bridge.lowcmd import MODE_ENABLE, NUM_JOINTS, LowCmdView
from downbeat.control.bridge.remote import BUTTONS, FRAME_BYTES, remote_frame
from downbeat.lcm_types import g1_low_cmd_t
from downbeat.sim.crane import Crane
from downbeat.sim.errors import SimError
from downbeat.sim.noise import NoiseSource, roll_pitch_yaw, rotate
from downbeat.sim.plant import Plant, PlantConfig

FOR_EVER_US = 1 << 60
"""The public simulators hold the last command for ever; so do we: whoever commands must brake."""
PRESS_S = 0.2
LOWER_AFTER_S, RELEASE_AFTER_S = 2.6, 8.0
"""A helpful operator lowers the robot in its pose, and lets go once it stands by itself."""
BMS_BYTES = 168
WORDS = (
    "press, remote, crane, drop, crc, mode_machine, tick, nan, fault, hot, case, soc, half, report"
)


@dataclass(slots=True)
class Heard:
    """What the motors were told; the test's view of the bridge.

    Attributes:
        commands: LowCmd that arrived.
        bad_crc: With a wrong checksum; ignored.
        bad_mode: With another mode_machine than the robot's; ignored.
        first_jump_rad: First target with stiffness against the measured pose; NaN: none yet.
        kind: Of the newest: "zero", "damping" or "position".
        kind_since_s: Since when it is that [s of the robot's time].
        last_s: Arrival of the newest [s].
        longest_gap_s: Between two commands.
    """

    commands: int = 0
    bad_crc: int = 0
    bad_mode: int = 0
    first_jump_rad: float = math.nan
    kind: str = ""
    kind_since_s: float = 0.0
    last_s: float = 0.0
    longest_gap_s: float = 0.0


class MotorSide:
    """The robot behind rt/lowcmd and rt/lowstate."""

    def __init__(self, config: PlantConfig | None = None, mode_machine: int = 5) -> None:
        """Hang a robot on the crane."""
        settings = config or PlantConfig(start="free", command_delay_us=0)
        self.plant = Plant(settings)
        self.crane = Crane(self.plant.data)
        self.heard = Heard()
        self.mode_machine = mode_machine
        self.soc = 80
        self.has_operator = False
        """The crane is worked without being told."""
        self.is_dropped = False
        self.is_half = False
        self._noise = NoiseSource(settings.noise, settings.seed, num_imus=2)
        self._utime = 0
        self._tick = 1_000_000
        self._bad_crc_left = 0
        self._has_remote = True
        self._pressed: tuple[str, ...] = ()
        self._pressed_until = 0
        self._nan_motor = -1
        self._state = bytearray(STATE_BYTES)
        self._state[0:4] = CDR_HEAD
        self._motors = np.frombuffer(self._state, STATE_MOTOR, NUM_JOINTS, STATE_FIRST_MOTOR)
        self._motors["temperature"] = (35, 40)
        self._motors["vol"] = 48.0

    @property
    def seconds(self) -> float:
        """Time of the robot since it was switched on [s]."""
        return self._utime * 1e-6

    # ------------------------------------------------------------------ what is done to it

    def do(self, line: str) -> str:
        """Obey one line: a word and its arguments; returns what to print, empty: nothing.

        press BUTTON | remote on/off | crane lower/release | drop on/off | crc N | mode_machine N |
        tick N | nan MOTOR | fault MOTOR CODE | hot MOTOR C | case MOTOR C | soc PERCENT |
        half on/off | report

        Raises:
            SimError: The word or its arguments are not valid.
        """
        word, *arguments = line.split() or [""]
        try:
            return self._do(word, arguments)
        except (IndexError, ValueError, KeyError) as error:
            raise SimError(f"{line!r} cannot be done ({error}); words are {WORDS}.") from error

    def _do(self, word: str, arguments: list[str]) -> str:
        numbers = [int(text) for text in arguments if text.lstrip("-").isdigit()]
        is_on = arguments[:1] == ["on"]
        if word == "press":
            BUTTONS.index(arguments[0])
            self._pressed = tuple(arguments)
            self._pressed_until = self._utime + round(PRESS_S * 1e6)
        elif word == "remote":
            self._has_remote = is_on
        elif word == "crane":
            {"lower": self.crane.lower, "release": self.crane.release}[arguments[0]]()
        elif word == "drop":
            self.is_dropped = is_on
        elif word == "half":
            self.is_half = is_on
        elif word == "crc":
            self._bad_crc_left = numbers[0]
        elif word == "mode_machine":
            self.mode_machine = numbers[0]
        elif word == "tick":
            self._tick += numbers[0]
        elif word == "nan":
            self._nan_motor = numbers[0]
        elif word == "fault":
            self._motors["motorstate"][numbers[0]] = numbers[1]
        elif word in ("hot", "case"):
            self._motors["temperature"][numbers[0], int(word == "hot")] = numbers[1]
        elif word == "soc":
            self.soc = numbers[0]
        elif word == "report":
            return self.report()
        else:
            raise KeyError(word)
        return ""

    def report(self) -> str:
        """Return everything a test wants to know, as one JSON line."""
        data = self.plant.data
        tilt = math.acos(max(-1.0, min(1.0, 1.0 - 2.0 * float((data.qpos[4:6] ** 2).sum()))))
        values = asdict(self.heard)
        values |= {
            "seconds": self.seconds,
            "height": float(data.qpos[2]),
            "tilt": tilt,
            "crane": self.crane.share,
        }
        return json.dumps(
            {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in values.items()}
        )

    # ------------------------------------------------------------------ commands

    def take_command(self, payload: bytes) -> None:
        """Obey a LowCmd, as a robot does: checksum and mode_machine must be right."""
        heard = self.heard
        if len(payload) != CMD_BYTES:
            heard.bad_crc += 1
            return
        view = LowCmdView(payload)
        if not view.is_intact:
            heard.bad_crc += 1
            return
        if view.mode_machine != self.mode_machine:
            heard.bad_mode += 1
            return
        self._note(view)
        is_enabled = np.frombuffer(view.modes, np.uint8) == MODE_ENABLE  # (29,)
        msg: Any = g1_low_cmd_t()
        msg.header.utime = self._utime
        msg.valid_until_utime = FOR_EVER_US
        msg.mode = g1_low_cmd_t.MODE_POSITION
        msg.joint_pos_target = view.q
        msg.joint_vel_target = view.dq
        msg.joint_torque_ff = view.tau * is_enabled
        msg.joint_stiffness = view.kp * is_enabled
        msg.joint_damping = view.kd * is_enabled
        self.plant.command(msg, self._utime)

    def _note(self, view: LowCmdView) -> None:
        heard, now = self.heard, self.seconds
        if heard.commands:
            heard.longest_gap_s = max(heard.longest_gap_s, now - heard.last_s)
        heard.commands += 1
        heard.last_s = now
        kind = "position" if view.kp.any() else "damping" if view.kd.any() else "zero"
        if kind == "position" and math.isnan(heard.first_jump_rad):
            heard.first_jump_rad = float(np.abs(view.q - self.plant.joint_pos).max())
        if kind != heard.kind:
            heard.kind, heard.kind_since_s = kind, now

    # ------------------------------------------------------------------ physics and states

    def step(self) -> None:
        """Advance by one timestep (2 ms)."""
        plant = self.plant
        if self.has_operator and self.heard.kind == "position":
            held_s = self.seconds - self.heard.kind_since_s
            if held_s > RELEASE_AFTER_S:
                self.crane.release()
            elif held_s > LOWER_AFTER_S:
                self.crane.lower()
        self.crane.apply(plant.model, plant.data, plant.config.timestep_s)
        plant.step(self._utime)
        self._utime += plant.step_us
        self._tick += plant.step_us // 1000
        self._noise.draw()

    def lowstate(self) -> bytes:
        """Return the present LowState on the wire."""
        state, plant, noise, motors = self._state, self.plant, self._noise, self._motors
        motors["q"] = plant.joint_pos + noise.joint_pos
        motors["dq"] = plant.joint_vel + noise.joint_vel
        motors["tau_est"] = plant.joint_torque
        if self._nan_motor >= 0:
            motors["q"][self._nan_motor] = np.nan
        state[13] = self.mode_machine
        struct.pack_into("<I", state, 16, self._tick)
        state[20:74] = self._imu(0)
        state[STATE_REMOTE] = self._remote()
        checksum = crc32_words(state_image(bytes(state)))
        if self._bad_crc_left:
            self._bad_crc_left -= 1
            checksum ^= 1
        state[STATE_CRC] = checksum.to_bytes(4, "little")
        return bytes(state[: STATE_BYTES // 2]) if self.is_half else bytes(state)

    def torso_imu(self) -> bytes:
        """Return the present state of the torso's IMU on the wire."""
        return CDR_HEAD + self._imu(1) + b"\x00\x00"

    def battery(self) -> bytes:
        """Return the present BmsState on the wire."""
        payload = bytearray(BMS_BYTES)
        payload[0:4] = CDR_HEAD
        payload[104] = self.soc
        return bytes(payload)

    def _imu(self, index: int) -> bytes:
        quat, gyro, accel = self.plant.imu(index)
        rotation, gyro_noise, accel_noise = self._noise.imu(index)
        measured = rotate(quat, rotation)
        numbers = (*measured, *(gyro + gyro_noise), *(accel + accel_noise))
        return struct.pack("<13fh", *numbers, *roll_pitch_yaw(measured), 40)

    def _remote(self) -> bytes:
        if not self._has_remote:
            return bytes(FRAME_BYTES)
        is_down = self._utime < self._pressed_until
        return remote_frame(self._pressed if is_down else ())
