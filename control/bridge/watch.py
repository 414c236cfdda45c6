"""What the bridge looks at before every command: a pure function of states and time."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from downbeat.control.bridge.faults import BRIDGE_FAULTS, BridgeReaction
from downbeat.control.bridge.lowstate import StateDecoder
from downbeat.control.bridge.remote import button_mask, buttons_of, is_silent, pressed_names
from downbeat.control.bridge.settings import BridgeSettings
from downbeat.runtime.faults import Fault, FaultMonitor

BODY_PERIOD = 10
"""Temperatures are looked at in every tenth state."""


class RobotWatch:
    """Judges every state; remembers the remote, the battery and the hysteresis."""

    def __init__(self, settings: BridgeSettings) -> None:
        self._settings = settings
        self._monitor = FaultMonitor(BRIDGE_FAULTS)
        self._estop_mask = button_mask(settings.estop_buttons)
        self._confirm_mask = button_mask((settings.confirm_button,))
        self._texts: dict[str, str] = {}
        self._hot: dict[str, str] = {}
        self._active: tuple[Fault[BridgeReaction], ...] = ()
        self._count = 0
        self._buttons = 0
        self._remote_utime = 0
        self.remote_heard = False
        self.is_confirmed = False
        """The confirm button went down in the newest state."""
        self.battery_soc = float("nan")
        self.state_utime = 0
        """When the newest good state came [us]; 0: none yet."""
        self.num_states = 0

    def take_state(self, state: StateDecoder, utime: int) -> None:
        """Judge a good state that came at `utime` [us]."""
        found: dict[str, str] = {}
        self.state_utime = utime
        self.num_states += 1
        self._take_remote(state.remote, utime, found)
        faults = state.motor_faults
        if faults.any():
            found["motor_fault"] = str(int((faults != 0).argmax()))
        if self._count % BODY_PERIOD == 0:
            self._hot = self._judge_heat(state.temperatures)
        self._count += 1
        found.update(self._hot)
        if self.battery_soc < self._settings.battery_min:  # NaN, not known, compares false
            found["battery_empty"] = f"{100.0 * self.battery_soc:.0f}"
        if found:
            self._texts.update(found)
        self._active = self._monitor.update(found)

    def _take_remote(self, frame: bytes, utime: int, found: dict[str, str]) -> None:
        self.is_confirmed = False
        if is_silent(frame):
            self._buttons = 0
            return
        self.remote_heard = True
        self._remote_utime = utime
        buttons = buttons_of(frame)
        if buttons & self._estop_mask:
            found["estop_button"] = "+".join(pressed_names(buttons & self._estop_mask))
        self.is_confirmed = bool(buttons & ~self._buttons & self._confirm_mask)
        self._buttons = buttons

    def _judge_heat(self, temperatures: npt.NDArray[np.int16]) -> dict[str, str]:
        hot: dict[str, str] = {}
        limits = (self._settings.case_max_c, self._settings.winding_max_c)
        for name, values, limit in zip(("case_hot", "winding_hot"), temperatures, limits):
            worst = int(np.argmax(values))
            if values[worst] > limit:
                hot[name] = f"{worst} ({values[worst]} C)"
        return hot

    def faults(self, utime: int) -> list[tuple[Fault[BridgeReaction], str]]:
        """Return what is wrong at `utime` [us], each row with its sentence."""
        raised = [(row, row.message.format(self._texts.get(row.name, ""))) for row in self._active]
        stale_s = (utime - self.state_utime) * 1e-6
        if self.state_utime and stale_s > self._settings.state_stale_s:
            raised.append(sentence("state_stale", f"{stale_s * 1e3:.0f} ms"))
        if self.remote_heard:
            silent_s = (utime - self._remote_utime) * 1e-6
            if silent_s > self._settings.remote_lost_s:
                raised.append(sentence("remote_lost", f"{silent_s:.1f}"))
        return raised

    def is_fresh(self, utime: int) -> bool:
        """Whether the robot reports now."""
        age_s = (utime - self.state_utime) * 1e-6
        return bool(self.state_utime) and age_s <= self._settings.state_stale_s


def sentence(name: str, value: str) -> tuple[Fault[BridgeReaction], str]:
    """Return a row and its message with the measured value."""
    row = BRIDGE_FAULTS.named(name)
    return row, row.message.format(value)
