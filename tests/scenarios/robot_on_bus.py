"""A simulated robot and its control on a real LCM bus, until somebody ends it: `... URL`.

Real UDP, simulated time at about its real pace: control waits for the state of its tick, so that a
loaded machine makes the robot slow and not blind.
"""

import sys
import time

from downbeat.control.core import ControlCore
from downbeat.control.node import ControlNode
from downbeat.control.policy import SkillLibrary
from downbeat.runtime.bus import open_udpm
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.sim.lockstep import STEP_US
from downbeat.sim.node import SimNode
from downbeat.sim.plant import PlantConfig

SKILLS = frozenset({"stand", "kpop", "wave"})
MAX_S = 60.0
WAIT_S = 0.05


def main(url):
    clock = SimClock(SIM_EPOCH_UTIME)
    sim_bus, control_bus = open_udpm(url, clock, "sim"), open_udpm(url, clock, "control")
    core = ControlCore(SkillLibrary.load(only=SKILLS))
    sim, control = SimNode(sim_bus, PlantConfig()), ControlNode(control_bus, core)
    begun = due = time.monotonic()
    while time.monotonic() - begun < MAX_S:
        due = max(due + STEP_US * 1e-6, time.monotonic() - WAIT_S)
        time.sleep(max(0.0, due - time.monotonic()))
        utime = clock.utime() + STEP_US
        clock.advance_to(utime)
        sim.step(utime)
        if utime % control.period_us == 0:
            wait_for_state(control_bus, utime)
            control.step(utime)


def wait_for_state(bus, utime):
    end = time.monotonic() + WAIT_S
    while time.monotonic() < end:
        bus.pump(0.002)
        latest = bus.latest("G1_LOW_STATE")
        if latest is not None and latest.msg.header.utime >= utime:
            return


if __name__ == "__main__":
    main(sys.argv[1])
