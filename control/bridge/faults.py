"""The bridge's own fault table: it stops the robot also when control does not.

Every row leads to damping, latched until the operator clears it. Rows are judged once per state,
500 times a second; names are raised by `control/bridge/watch.py`.
"""

from __future__ import annotations

from enum import IntEnum

from downbeat.runtime.faults import Fault, FaultTable


class BridgeReaction(IntEnum):
    """What the bridge does, harder is larger."""

    NONE = 0
    DAMPING = 3


_D = BridgeReaction.DAMPING

BRIDGE_FAULTS: FaultTable[BridgeReaction] = FaultTable(
    (
        Fault(101, "estop_button", _D, "Emergency stop on the remote ({})."),
        Fault(102, "estop_message", _D, "Emergency stop by {}."),
        Fault(103, "state_stale", _D, "The robot has not reported for {}."),
        Fault(104, "command_expired", _D, "Control's last command expired {} ago."),
        Fault(105, "remote_lost", _D, "The remote has not been heard for {} s."),
        Fault(106, "motor_fault", _D, "Motor {} reports a fault.", raise_after_ticks=5),
        Fault(107, "winding_hot", _D, "The winding of motor {} is too hot.", raise_after_ticks=25),
        Fault(108, "case_hot", _D, "The casing of motor {} is too hot.", raise_after_ticks=25),
        Fault(109, "battery_empty", _D, "The battery is at {} %.", raise_after_ticks=500),
        Fault(110, "second_commander", _D, "Somebody else commands the robot ({} messages)."),
        Fault(111, "leaving_control", _D, "Control does not answer: {}."),
        Fault(113, "control_passive", _D, "Control let the robot go ({})."),
        Fault(112, "broken", _D, "The bridge itself failed: {}."),
    )
)
