"""The black box: what happened before a trip is on disk; the ticks after it are not disturbed."""

import json

import numpy as np

from downbeat.control.blackbox import WRITTEN_PER_TICK, BlackBox
from downbeat.control.core import ControlCore
from downbeat.control.node import ControlNode
from downbeat.lcm_types import estop_t
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.runtime.log import read_messages
from downbeat.sim.lockstep import Lockstep
from downbeat.sim.node import SimNode


def run(library, folder, seconds, estop_at_s):
    clock = SimClock(SIM_EPOCH_UTIME)
    hub = MemqHub()
    control_bus = hub.endpoint("control", clock)
    box = BlackBox(folder, clock)
    control = ControlNode(control_bus, ControlCore(library), blackbox=box)
    scheduler = Lockstep(clock, (SimNode(hub.endpoint("sim", clock)), control))
    anyone = hub.endpoint("operator", clock)

    def each(utime):
        if utime == SIM_EPOCH_UTIME + round(estop_at_s * 1e6):
            msg = estop_t()
            msg.header.utime = utime
            msg.level, msg.source = estop_t.DAMP, "test"
            anyone.publish("ESTOP", msg)
        return True

    scheduler.run_until(SIM_EPOCH_UTIME + round(seconds * 1e6), each)
    scheduler.close()
    return box


def test_last_ten_seconds_are_written_on_a_trip(library, tmp_path):
    run(library, tmp_path, 13.0, 12.0)
    (folder,) = tmp_path.iterdir()
    trip_utime = int(folder.name)
    assert abs(trip_utime - (SIM_EPOCH_UTIME + 12_000_000)) <= 20_000
    messages = list(read_messages(folder / "bus.lcmlog"))
    span_s = (messages[-1].utime - messages[0].utime) * 1e-6
    assert 9.9 < span_s <= 10.1
    states = [m for m in messages if m.channel == "G1_LOW_STATE"]
    assert np.isclose(len(states), 5000, atol=10)
    assert any(m.channel == "ESTOP" for m in messages)
    head, *ticks = [json.loads(line) for line in (folder / "ticks.jsonl").open()]
    assert "Emergency stop by test" in head["trip"]
    assert len(ticks) == 500


def test_nothing_is_written_without_a_trip(library, tmp_path):
    run(library, tmp_path / "box", 1.0, 99.0)
    assert not (tmp_path / "box").exists()


def test_dump_is_spread_over_ticks(library, tmp_path):
    """At most so many messages a tick: the tick after an accident is on time, too."""
    box = run(library, tmp_path, 6.1, 6.0)
    assert box.dumps == 1
    (folder,) = tmp_path.iterdir()
    assert (folder / "bus.lcmlog").stat().st_size > 0
    assert WRITTEN_PER_TICK <= 64


def test_unwritable_folder_does_not_stop_control(library, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    box = run(library, blocked / "box", 2.0, 1.0)
    assert box.dumps == 1
