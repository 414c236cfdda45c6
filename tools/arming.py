"""Arm control again, and say in one sentence whether it is armed now, or why not.

On a real robot only the bridge arms, behind the steps that somebody confirms on the remote: there
nothing is sent.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field

from downbeat.control.faults import FAULTS, Reaction
from downbeat.lcm_types import control_status_t, estop_t, g1_low_state_t, operator_command_t
from downbeat.policies.manifest import SkillLimits
from downbeat.runtime.bus import DEFAULT_URL, Bus, open_udpm
from downbeat.runtime.clock import WallClock

LISTEN_S = 0.4
"""Long enough for a second publisher, and for an emergency stop that somebody holds."""
ANSWER_S = 1.5
STAND_S = 6.0
"""The ramp into the stand pose takes 2 s of it."""
SETTLED_S = 0.5
"""A robot that trips at once was not armed."""
REPEATS, REPEAT_S = 3, 0.02
"""UDP may lose one."""
DOWN_BELOW_M = 0.5
"""Of the pelvis above the soles; it stands at 0.76."""
PASSIVE = (control_status_t.ZERO_TORQUE, control_status_t.DAMPING, control_status_t.ESTOP)
HARD = {row.id for row in FAULTS if row.reaction >= Reaction.DAMPING}
"""Faults against which control does not take ARM."""
NO_CONTROL = "no control process answers; `downbeat control --show SHOW.toml` starts one"
HARDWARE = (
    "nothing was sent: a real robot is armed by the bridge, step by step; press start on the "
    "remote, and where something has tripped type `downbeat stop --level clear` before that "
    "(docs/robot.md)"
)
REPLAYED = "nothing was sent: what is on the bus is a recorded robot"
TWO_ROBOTS = (
    "nothing was sent: two processes say where the robot is (G1_LOW_STATE); end one of them"
)


@dataclass(slots=True)
class Heard:
    """What the bus says.

    Attributes:
        status: Newest of control; None: it is silent.
        state: Newest of the robot; None: it is silent.
        foreign: Messages of a second robot.
        stopped_by: Who has sent an emergency stop meanwhile.
    """

    status: control_status_t | None = None
    state: g1_low_state_t | None = None
    foreign: int = 0
    stopped_by: list[str] = field(default_factory=list)


def arm(url: str) -> int:
    """Send ARM where control takes it; 0 if it is armed then, 1 if not, with the reason."""
    bus = open_udpm(url or DEFAULT_URL, WallClock(), "operator")
    try:
        is_armed, sentence = arm_on(bus)
    finally:
        bus.close()
    print(f"downbeat: {sentence}.", file=sys.stdout if is_armed else sys.stderr)
    return 0 if is_armed else 1


def arm_on(bus: Bus) -> tuple[bool, str]:
    """Arm control on an open bus.

    Returns:
        Whether it is armed now, and what to tell the operator, without the full stop.
    """
    bus.subscribe("CONTROL_STATUS", "ESTOP")
    bus.subscribe_newest("G1_LOW_STATE")
    heard = Heard()
    begin = bus.clock.utime()
    _listen(bus, heard, LISTEN_S)
    while heard.status is None and bus.clock.utime() - begin < ANSWER_S * 1e6:
        _listen(bus, heard, 0.1)
    status = heard.status
    if status is not None and status.mode not in PASSIVE:
        return True, f"control is armed already{_addition(status)}"
    if hindrance := hindrance_of(heard):
        return False, hindrance
    for _ in range(REPEATS):
        msg = operator_command_t()
        msg.header.utime = bus.clock.utime()
        msg.command, msg.source = operator_command_t.ARM, "downbeat arm"
        bus.publish("OPERATOR_COMMAND", msg)
        _listen(bus, heard, REPEAT_S)
    return _await_stand(bus, heard)


def hindrance_of(heard: Heard) -> str:
    """Say why control would not take ARM, or must not be sent it; empty: nothing is in the way."""
    status, state = heard.status, heard.state
    if status is None:
        return NO_CONTROL
    if heard.foreign:
        return TWO_ROBOTS
    if state is not None and state.source != g1_low_state_t.SOURCE_SIM:
        return HARDWARE if state.source == g1_low_state_t.SOURCE_HARDWARE else REPLAYED
    return _steps_to_take(heard, status)


def _steps_to_take(heard: Heard, status: control_status_t) -> str:
    """Say what has to be done before a simulated robot can be armed; empty: nothing."""
    steps = []
    why = status.fault_text.rstrip(".") if status.fault in HARD else ""
    if heard.state is None:
        if status.mode != control_status_t.ESTOP:
            why = "no robot is on the bus"
        steps.append("start `downbeat sim`")
    elif status.tilt > SkillLimits().tilt_rad or status.base_height < DOWN_BELOW_M:
        why = why or "the robot is down"
        steps.append("start `downbeat sim` anew, for the robot is down and nothing gets it up")
    if heard.stopped_by:
        why = why or "somebody presses the emergency stop"
        steps.append(f"let {heard.stopped_by[-1]} release the emergency stop")
    if status.fault in HARD or heard.stopped_by:
        steps.append("`downbeat stop --level clear`")
    if not steps:
        return ""
    return f"control is not armed: {why}; first {', then '.join(steps)}, then `downbeat arm`"


def _await_stand(bus: Bus, heard: Heard) -> tuple[bool, str]:
    """Wait until the robot stands, and for a moment more."""
    sent = bus.clock.utime()
    stands_since = 0
    was_armed = False
    while (now := bus.clock.utime()) - sent < STAND_S * 1e6:
        _listen(bus, heard, 0.05)
        status = heard.status
        if status is None or status.mode in PASSIVE:
            stands_since = 0
            if was_armed or heard.stopped_by:
                break
            if now - sent > ANSWER_S * 1e6:
                break
            continue
        was_armed = True
        if status.mode != control_status_t.MOVE_TO_POSE:
            stands_since = stands_since or now
            if now - stands_since >= SETTLED_S * 1e6:
                return True, f"control is armed, the robot stands{_addition(status)}"
    if hindrance := hindrance_of(heard):
        return False, hindrance
    if was_armed:
        return False, f"control was armed, but the robot does not stand after {STAND_S:.0f} s"
    return False, "control did not take the command; `downbeat spy` shows what it does"


def _addition(status: control_status_t) -> str:
    """Return what is wrong with an armed robot, and what it plays."""
    playing = f" and plays {status.skill}" if status.skill not in ("", "stand") else ""
    wrong = f", but: {status.fault_text.rstrip('.')}" if status.fault else ""
    return playing + wrong


def _listen(bus: Bus, heard: Heard, seconds: float) -> None:
    """Take what comes within a time."""
    end = bus.clock.utime() + round(seconds * 1e6)
    while (left_us := end - bus.clock.utime()) > 0:
        bus.pump(min(0.02, left_us * 1e-6))
        for received in bus.take("ESTOP"):
            if received.msg.level != estop_t.CLEAR:
                heard.stopped_by.append(received.msg.source or "somebody")
        status, state = bus.latest("CONTROL_STATUS"), bus.latest("G1_LOW_STATE")
        heard.status = None if status is None else status.msg
        heard.state = None if state is None else state.msg
        heard.foreign = bus.counters.foreign_on("G1_LOW_STATE")
