"""Clocks, the rate keeper and the real-time loop."""

import gc
import os
import signal
import subprocess
import sys
import time

import pytest

from downbeat.lcm_types import heartbeat_t
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import (
    SIM_EPOCH_UTIME,
    ClockError,
    ReplayClock,
    SimClock,
    TimeBase,
    WallClock,
)
from downbeat.runtime.node import run_node
from downbeat.runtime.rate import DurationRecorder, DurationStats, RateKeeper
from downbeat.runtime.realtime import configure_real_time


class ScriptedClock:
    """A clock that sleeps exactly, plus a scripted lateness per sleep."""

    def __init__(self, utime, lateness_us=()):
        self.now = utime
        self._lateness = list(lateness_us)

    def utime(self):
        return self.now

    def sleep_until(self, utime):
        self.now = max(self.now, utime) + (self._lateness.pop(0) if self._lateness else 0)


def test_wall_clock_follows_the_given_base():
    base = TimeBase(epoch_utime=1_000_000, epoch_monotonic_ns=time.monotonic_ns())
    clocks = WallClock(base), WallClock(base)
    times = [clock.utime() for clock in (*clocks, *clocks)]
    assert times == sorted(times)
    assert times[0] >= 999_999
    target = clocks[0].utime() + 3_000
    clocks[0].sleep_until(target)
    assert clocks[1].utime() >= target


def test_sleep_until_the_past_returns_at_once(monkeypatch):
    slept = []
    monkeypatch.setattr("time.sleep", slept.append)
    clock = WallClock()
    clock.sleep_until(clock.utime() - 10**12)
    assert slept == []


def test_simulated_time_does_not_go_back():
    clock = SimClock()
    assert clock.utime() == SIM_EPOCH_UTIME and SIM_EPOCH_UTIME % 20_000 == 0
    clock.advance_to(SIM_EPOCH_UTIME + 5)
    with pytest.raises(ClockError, match="back"):
        clock.advance_to(SIM_EPOCH_UTIME)
    replay = ReplayClock()
    replay.follow(7)
    replay.follow(3)
    assert replay.utime() == 7


def test_deadlines_are_multiples_of_the_period_whatever_the_lateness():
    clock = ScriptedClock(1_003, lateness_us=[5, 700, 0, 40])
    keeper = RateKeeper(clock, 1_000)
    assert [keeper.wait() for _ in range(4)] == [2_000, 3_000, 4_000, 5_000]
    assert keeper.missed == 0
    assert keeper.lateness.stats().max_us == 700


def test_overrun_gives_up_deadlines_and_goes_on_with_the_newest():
    clock = ScriptedClock(0)
    keeper = RateKeeper(clock, 1_000)
    assert keeper.wait() == 1_000
    clock.now += 3_400
    assert keeper.wait() == 4_000
    assert keeper.missed == 2
    assert keeper.timing() == (400, 3_400, 2)
    assert keeper.wait() == 5_000


def test_catch_up_serves_late_deadlines_back_to_back():
    clock = ScriptedClock(0)
    keeper = RateKeeper(clock, 1_000, max_catch_up=5)
    keeper.wait()
    clock.now += 3_400
    assert [keeper.wait() for _ in range(4)] == [2_000, 3_000, 4_000, 5_000]
    assert keeper.missed == 0


def test_percentiles_are_of_the_samples_and_the_maximum_of_all():
    recorder = DurationRecorder(capacity=1000)
    assert recorder.stats() == DurationStats()
    recorder.add(50_000)
    for value in range(1, 1001):
        recorder.add(value)
    stats = recorder.stats()
    assert stats.count == 1001 and stats.max_us == 50_000
    assert stats.p50_us == pytest.approx(500.5)
    assert stats.p99_us == pytest.approx(990.01)
    assert stats.p999_us == pytest.approx(999.001)


def test_samples_come_back_in_order_and_the_oldest_go_first():
    recorder = DurationRecorder(capacity=4)
    for value in (1, 2, 3):
        recorder.add(value)
    assert recorder.samples().tolist() == [1, 2, 3]
    for value in (4, 5, 6):
        recorder.add(value)
    assert recorder.samples().tolist() == [3, 4, 5, 6]


class CountingNode:
    name = "control"
    period_us = 20_000

    def __init__(self, clock=None, slow_step=None):
        self.steps = []
        self.closed = False
        self._clock, self._slow_step = clock, slow_step

    def step(self, utime):
        self.steps.append(utime)
        if len(self.steps) == self._slow_step:
            self._clock.now += 90_000

    def close(self):
        self.closed = True


def heartbeats(node, clock, **options):
    hub = MemqHub()
    bus, watcher = hub.endpoint("control", clock), hub.endpoint("supervisor", clock)
    watcher.subscribe("HEARTBEAT")
    report = run_node(node, clock, bus, **options)
    watcher.pump()
    return report, [r.msg for r in watcher.take("HEARTBEAT")]


def test_loop_steps_on_the_grid_and_beats_twice_a_second():
    clock = ScriptedClock(SIM_EPOCH_UTIME)
    node = CountingNode()
    report, beats = heartbeats(node, clock, end_utime=SIM_EPOCH_UTIME + 2_000_000)
    assert node.closed and report.steps == 100 and report.missed == 0
    assert all(utime % 20_000 == 0 for utime in node.steps)
    states = [beat.state for beat in beats]
    assert states[0] == heartbeat_t.STARTING and states[-1] == heartbeat_t.STOPPING
    assert set(states[1:-1]) == {heartbeat_t.READY} and len(states) == 6
    assert beats[1].process == "control" and beats[1].period_us == 20_000


def test_missed_deadlines_show_in_the_heartbeat():
    clock = ScriptedClock(SIM_EPOCH_UTIME)
    node = CountingNode(clock, slow_step=10)
    report, beats = heartbeats(node, clock, end_utime=SIM_EPOCH_UTIME + 2_000_000)
    assert report.missed == 3
    degraded = [beat.detail for beat in beats if beat.state == heartbeat_t.DEGRADED]
    assert len(degraded) == 1 and degraded[0].startswith("3 deadlines missed [cpu ")


def test_what_a_node_says_of_itself_goes_with_the_heartbeat():
    clock = ScriptedClock(SIM_EPOCH_UTIME)
    node = CountingNode()
    node.detail = "plant_realtime_factor=1.0"
    _, beats = heartbeats(node, clock, end_utime=SIM_EPOCH_UTIME + 600_000)
    assert beats[1].detail.startswith("plant_realtime_factor=1.0 [cpu ")


def test_node_that_raises_is_closed_and_says_stopping():
    clock = ScriptedClock(SIM_EPOCH_UTIME)
    node = CountingNode()
    node.step = lambda utime: 1 / 0
    hub = MemqHub()
    states = []
    hub.tap(lambda utime, channel, payload: states.append(heartbeat_t.decode(payload).state))
    with pytest.raises(ZeroDivisionError):
        run_node(node, clock, hub.endpoint("control", clock))
    assert node.closed and states[-1] == heartbeat_t.STOPPING


def test_loop_stops_on_sigterm_between_steps():
    node = CountingNode()
    node.step = lambda utime: os.kill(os.getpid(), signal.SIGTERM)
    before = signal.getsignal(signal.SIGTERM)
    report = run_node(node, WallClock())
    assert node.closed and report.steps == 1
    assert signal.getsignal(signal.SIGTERM) is before


def test_real_time_setup_degrades_with_one_sentence_each():
    code = (
        "import os, resource, gc\n"
        "from downbeat.runtime.realtime import configure_real_time\n"
        "report = configure_real_time()\n"
        "assert report.scheduler in ('fifo', 'other') and report.gc_frozen\n"
        "assert not gc.isenabled()\n"
        "refused = [report.scheduler == 'other', not report.memory_locked]\n"
        "assert len(report.messages) == sum(refused)\n"
        "is_fifo = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO\n"
        "assert is_fifo == (report.scheduler == 'fifo')\n"
        "print('ok')\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout == "ok\n", result.stderr


def test_threads_of_the_bus_get_the_right_as_well(free_url):
    code = (
        "import os\n"
        "from downbeat.runtime.bus import open_udpm\n"
        "from downbeat.runtime.clock import WallClock\n"
        "from downbeat.runtime.realtime import configure_real_time\n"
        f"bus = open_udpm({free_url!r}, WallClock(), 'control')\n"
        "bus.subscribe('G1_LOW_STATE')\n"
        "report = configure_real_time(30)\n"
        "threads = [int(name) for name in os.listdir('/proc/self/task')]\n"
        "assert len(threads) > 1\n"
        "policies = {os.sched_getscheduler(t) & ~os.SCHED_RESET_ON_FORK for t in threads}\n"
        "wanted = os.SCHED_FIFO if report.scheduler == 'fifo' else os.SCHED_OTHER\n"
        "assert policies == {wanted}, policies\n"
        "print('ok')\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout == "ok\n", result.stderr


def test_process_is_pinned_when_asked_and_an_impossible_processor_is_named():
    code = (
        "import os\n"
        "from downbeat.runtime.realtime import configure_real_time\n"
        "last = max(os.sched_getaffinity(0))\n"
        "report = configure_real_time(30, freeze_gc=False, cpu=4096)\n"
        "assert any('4096' in text and str(last) in text for text in report.messages)\n"
        "report = configure_real_time(30, freeze_gc=False, cpu=last)\n"
        "assert report.cpus == (last,) and os.sched_getaffinity(0) == {last}\n"
        "print('ok')\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout == "ok\n", result.stderr


def test_real_time_setup_without_permission_says_so(monkeypatch):
    def refuse(*_args):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr("downbeat.runtime.realtime._try_lock_memory", lambda messages: True)
    report = configure_real_time(freeze_gc=False)
    assert report.scheduler == "other" and report.priority == 0
    assert len(report.messages) == 1 and "ulimit -r" in report.messages[0]
    assert gc.isenabled()
