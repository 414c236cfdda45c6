"""A control core on fake time, with the bundled skills."""

from typing import Any

import numpy as np

from downbeat.catalog.robot import load_g1
from downbeat.control.core import ControlCore, TickInput
from downbeat.control.policy import SkillLibrary
from downbeat.lcm_types import g1_low_state_t, skill_request_t, skill_status_t

START = 1_700_000_000_000_000


class Rig:
    """Steps a core with an upright robot in its default pose."""

    def __init__(self, library: SkillLibrary) -> None:
        self.core = ControlCore(library)
        self.now = START
        self.tick_number = 0
        self.log: list[Any] = []
        self.changes: list[Any] = []
        self.next_id = 1

    def state(self) -> Any:
        state = g1_low_state_t()
        state.header.utime = self.now
        state.imu_pelvis.quat = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
        state.imu_pelvis.gyro = np.full(3, 1e-4 * (self.tick_number % 7), np.float32)  # it trembles
        state.imu_pelvis.accel = np.array([0.0, 0.0, 9.81], np.float32)
        state.battery_soc = float("nan")
        state.joint_pos = np.asarray(load_g1().default_joint_pos, np.float32)
        state.joint_vel = np.zeros(29, np.float32)
        state.motor_fault = np.zeros(29, np.int32)
        return state

    def tick(self, requests=(), state="fresh", age_us=0, **inputs: Any) -> Any:
        chosen = self.state() if isinstance(state, str) else state
        output = self.core.tick(
            TickInput(self.now, self.tick_number, chosen, age_us, tuple(requests), **inputs)
        )
        self.now += 20_000
        self.tick_number += 1
        self.log.append(output)
        self.changes += output.changes
        return output

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 50)):
            self.tick()

    def request(self, skill: str, onset_s: float = 0.0, **fields: Any) -> Any:
        msg = skill_request_t()
        msg.request_id = self.next_id
        self.next_id += 1
        msg.skill = skill
        msg.start_utime = self.now + round(onset_s * 1e6)
        msg.phase_rate = 1.0
        msg.source = skill_request_t.SOURCE_MUSIC
        for name, value in fields.items():
            setattr(msg, name, value)
        return msg

    def states_of(self, request_id: int) -> list[str]:
        names = {v: k for k, v in vars(skill_status_t).items() if k.isupper()}
        return [names[c.state] for c in self.changes if c.key[1] == request_id]

    def onset_utime(self, skill: str) -> int:
        """First tick at which `skill` has weight >= 0.5."""
        for output in self.log:
            if output.status.skill == skill and output.status.blend_weight >= 0.5:
                return int(output.status.header.utime)
        raise AssertionError(f"{skill} never began")
