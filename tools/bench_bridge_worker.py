"""The two ends of `downbeat bench bridge`: a robot on DDS and a control process on LCM.

Neither computes anything: the robot writes a state every 2 ms and notes when each command arrives,
control notes when each state arrives and sends a command every 20 ms. Stamps are CLOCK_MONOTONIC,
the same for both. A state is known by its tick; a command by the speed it asks of the last joint.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from typing import Any

import numpy as np

from downbeat.catalog.robot import load_g1
from downbeat.control.bridge.crc import crc32_words
from downbeat.control.bridge.layout import (
    CDR_HEAD,
    NUM_SLOTS,
    STATE_BYTES,
    STATE_CRC,
    STATE_FIRST_MOTOR,
    STATE_MOTOR,
    state_image,
)
from downbeat.control.bridge.lowcmd import NUM_JOINTS, LowCmdView
from downbeat.control.tick import COMMAND_VALID_US
from downbeat.lcm_types import g1_low_cmd_t
from downbeat.runtime.bus import open_udpm
from downbeat.runtime.clock import WallClock
from downbeat.runtime.realtime import configure_real_time

STATE_NS = 2_000_000
COMMAND_NS = 20_000_000
TOKENS = 199
"""Commands are numbered modulo this: speeds up to 200 rad/s pass the checks."""
ROBOT_PRIORITY, CONTROL_PRIORITY = 60, 50


def _bench_state() -> bytearray:
    """Return a LowState of a robot that hangs still in the stand pose."""
    state = bytearray(STATE_BYTES)
    state[0:4] = CDR_HEAD
    state[13] = 5
    struct.pack_into("<f", state, 20, 1.0)
    motors = np.frombuffer(state, STATE_MOTOR, NUM_SLOTS, STATE_FIRST_MOTOR)
    motors["q"][:NUM_JOINTS] = load_g1().default_joint_pos
    return state


def robot(domain: int, seconds: float) -> dict[str, Any]:
    """Be the robot; returns when each state was written and each command arrived [ns]."""
    from downbeat.control.bridge import idl
    from downbeat.control.bridge.dds import Link

    link = Link("lo", domain)
    states = link.writer("rt/lowstate", idl.LowState_)
    commands = link.reader("rt/lowcmd", idl.LowCmd_)
    link.wake_on(commands)
    state = _bench_state()
    written: list[int] = []
    arrived: list[tuple[int, int]] = []
    lowcmds: list[int] = []
    last_token = 0
    configure_real_time(ROBOT_PRIORITY)
    next_ns = time.monotonic_ns()
    end_ns = next_ns + round(seconds * 1e9)
    while next_ns < end_ns:
        next_ns += STATE_NS
        while (left_ns := next_ns - time.monotonic_ns()) > 0:
            link.wait(left_ns * 1e-9)
            now_ns = time.monotonic_ns()
            for payload in commands.take():
                lowcmds.append(now_ns)
                token = round(float(LowCmdView(payload).dq[NUM_JOINTS - 1]))
                if token != last_token:
                    arrived.append((token, now_ns))
                    last_token = token
        struct.pack_into("<I", state, 16, len(written) + 1)
        state[STATE_CRC] = crc32_words(state_image(bytes(state))).to_bytes(4, "little")
        payload = bytes(state)
        written.append(time.monotonic_ns())
        states.write(payload)
    link.close()
    return {"written": written, "arrived": arrived, "lowcmds": lowcmds}


def control(url: str, seconds: float) -> dict[str, Any]:
    """Be control; returns when each state arrived and each command was sent [ns]."""
    bus = open_udpm(url, WallClock(), "control")
    bus.subscribe("G1_LOW_STATE", "OPERATOR_COMMAND")
    msg: Any = g1_low_cmd_t()
    msg.mode = g1_low_cmd_t.MODE_POSITION
    msg.joint_torque_ff = np.zeros(NUM_JOINTS, np.float32)
    msg.joint_stiffness = np.full(NUM_JOINTS, 40.0, np.float32)
    msg.joint_damping = np.full(NUM_JOINTS, 2.0, np.float32)
    msg.joint_pos_target = np.asarray(load_g1().default_joint_pos, np.float32)
    speeds = np.zeros(NUM_JOINTS, np.float32)
    arrived: list[tuple[int, int]] = []
    sent: list[tuple[int, int]] = []
    configure_real_time(CONTROL_PRIORITY)
    next_ns = time.monotonic_ns() + 7_300_000  # not in phase with the states
    end_ns = next_ns + round(seconds * 1e9)
    while next_ns < end_ns:
        left_s = (next_ns - time.monotonic_ns()) * 1e-9
        if left_s > 0.0:
            # Whole milliseconds to wait, the rest asleep: the command is sent on time.
            if left_s > 0.002:
                bus.pump(0.001)
            else:
                time.sleep(left_s)
                bus.pump()
            now_ns = time.monotonic_ns()
            arrived += [(r.msg.tick, now_ns) for r in bus.take("G1_LOW_STATE")]
            continue
        next_ns += COMMAND_NS
        token = len(sent) % TOKENS + 1
        speeds[-1] = token
        msg.joint_vel_target = speeds
        msg.header.utime = bus.clock.utime()
        msg.valid_until_utime = msg.header.utime + COMMAND_VALID_US
        sent.append((token, time.monotonic_ns()))
        bus.publish("G1_LOW_CMD", msg)
    bus.close()
    return {"arrived": arrived, "sent": sent, "lost": bus.counters.lost}


if __name__ == "__main__":
    role, address, length = sys.argv[1:4]
    print("ready", flush=True)
    result = (
        robot(int(address), float(length)) if role == "robot" else control(address, float(length))
    )
    print(json.dumps(result), flush=True)
