"""What an operator may set for the bridge; a TOML file, see docs/robot.md."""

from __future__ import annotations

from dataclasses import dataclass

from downbeat.control.bridge.remote import button_mask
from downbeat.control.errors import ControlError


@dataclass(frozen=True)
class BridgeSettings:
    """Settings of the bridge.

    Attributes:
        estop_buttons: Any one of these on the remote means damping, at once.
        confirm_button: The operator's yes to the next step.
        damping: [N m s/rad] of every joint in damping.
        ramp_s: From the measured pose to the stand pose [s].
        leave_s: Damping goes on for so long after the process was told to leave [s].
        state_stale_s: A robot that is silent for longer is not commanded any more [s].
        remote_lost_s: The remote is silent for longer [s]; the vendor's own wrapper says 3.
        winding_max_c: [deg C]; the vendor's recommended limit.
        case_max_c: [deg C]; likewise.
        battery_start: Least charge to start with, 0..1; the vendor's recommended limit.
        battery_min: Damping below, 0..1.
        handover_rad: Control's first target may be this far from the measured pose [rad].
        control_timeout_s: Control must answer the arming within this time [s].
    """

    estop_buttons: tuple[str, ...] = ("B", "select")
    confirm_button: str = "start"
    damping: float = 5.0
    ramp_s: float = 2.5
    leave_s: float = 2.0
    state_stale_s: float = 0.1
    remote_lost_s: float = 3.0
    winding_max_c: int = 120
    case_max_c: int = 85
    battery_start: float = 0.20
    battery_min: float = 0.08
    handover_rad: float = 0.6
    control_timeout_s: float = 5.0

    def __post_init__(self) -> None:
        """Refuse what would make the robot less safe than no bridge at all.

        Raises:
            ControlError: A value is outside its range.
        """
        button_mask((*self.estop_buttons, self.confirm_button))
        if not self.estop_buttons or self.confirm_button in self.estop_buttons:
            raise ControlError(
                "The remote needs an emergency stop button that is not the confirm button "
                f"{self.confirm_button!r} (estop_buttons)."
            )
        for name, low, high in _RANGES:
            value = getattr(self, name)
            if not low <= value <= high:
                raise ControlError(
                    f"{value} is not a possible {name}; valid are {low} to {high} "
                    "(bridge settings)."
                )


_RANGES = (
    ("damping", 1.0, 10.0),
    ("ramp_s", 1.0, 10.0),
    ("leave_s", 0.5, 30.0),
    ("state_stale_s", 0.01, 0.5),
    ("remote_lost_s", 0.5, 10.0),
    ("winding_max_c", 40, 130),
    ("case_max_c", 40, 100),
    ("battery_start", 0.0, 1.0),
    ("battery_min", 0.0, 0.5),
    ("handover_rad", 0.1, 1.0),
    ("control_timeout_s", 1.0, 60.0),
)
