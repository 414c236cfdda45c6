"""Run the bridge: its DDS side, its loop, and the way out through damping."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from downbeat.control.bridge.core import BridgeCore
from downbeat.control.bridge.motion_service import SERVICE, MotionService
from downbeat.control.bridge.node import BridgeNode, RobotTopics, WakeOnLcm
from downbeat.control.bridge.rpc import Service
from downbeat.lcm_types import heartbeat_t
from downbeat.runtime.node import Heartbeat

log = logging.getLogger("downbeat.bridge")

LOWSTATE, LOWCMD = "rt/lowstate", "rt/lowcmd"
TORSO_IMU, BATTERY = "rt/secondary_imu", "rt/lf/bmsstate"


def open_service(link: Any, name: str, timeout_s: float = 1.0) -> Service:
    """Return one of the robot's services."""
    from downbeat.control.bridge import idl

    requests = link.writer(f"rt/api/{name}/request", idl.Request_)
    responses = link.reader(f"rt/api/{name}/response", idl.Response_)
    return Service(requests, responses, timeout_s)


def robot_topics(link: Any, lenient: bool) -> RobotTopics:
    """Open everything that the bridge reads and writes.

    Args:
        link: The participant (`downbeat.control.bridge.dds.Link`).
        lenient: A simulator has no motion service.
    """
    from downbeat.control.bridge import idl

    states = link.reader(LOWSTATE, idl.LowState_)
    link.wake_on(states)
    return RobotTopics(
        states=states,
        torso_imu=link.reader(TORSO_IMU, idl.IMUState_),
        battery=link.reader(BATTERY, idl.BmsState_),
        foreign_commands=link.reader(LOWCMD, idl.LowCmd_, ignore_own=True),
        motors=link.writer(LOWCMD, idl.LowCmd_),
        motion=MotionService(open_service(link, SERVICE), may_be_absent=lenient),
        waiter=link,
    )


def run_bridge(
    node: BridgeNode,
    bus: Any,
    waker: WakeOnLcm,
    is_stopped: Callable[[], bool],
    extra: Callable[[int], None] | None = None,
) -> None:
    """Run until told to stop, then leave through damping; also when something breaks.

    Args:
        node: The process.
        bus: Its LCM endpoint.
        waker: Started; before the process became a real-time one, so that it is one too.
        is_stopped: Whether somebody wants it to end.
        extra: Called after every cycle with the time [us]: compatibility, lights.
    """
    clock = bus.clock
    heartbeat = Heartbeat(bus, node.name, node.period_us)
    heartbeat.publish(clock.utime(), heartbeat_t.STARTING)
    core: BridgeCore = node.core
    described: Any = node
    try:
        while not is_stopped():
            node.cycle()
            now = clock.utime()
            heartbeat.beat(now, node=described)
            if extra is not None:
                extra(now)
    except Exception as error:
        # Whatever it is: a robot that was commanded is braked first, explained after.
        log.exception("the bridge failed")
        core.fail(f"{type(error).__name__}: {error}", clock.utime())
        raise
    finally:
        waker.is_stopped = True
        leave(node, bus)


def leave(node: BridgeNode, bus: Any) -> None:
    """Brake for a while, then stop commanding; a robot never commanded is left alone."""
    core, clock = node.core, bus.clock
    heartbeat = Heartbeat(bus, node.name, node.period_us)
    heartbeat.publish(clock.utime(), heartbeat_t.STOPPING, node.detail)
    if core.is_silent:
        return
    core.leave(clock.utime())
    while not core.has_left(clock.utime()):
        try:
            node.cycle()
        except Exception:  # the states may be what broke; braking needs none
            log.exception("leaving, all the same")
            node.brake()
