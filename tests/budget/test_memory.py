"""Control does not grow: with the collector off, whatever a tick leaves behind stays for ever."""

import gc
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from downbeat.control.core import ControlCore
from downbeat.control.policy import SkillLibrary
from downbeat.lcm_types import skill_request_t
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SimClock
from downbeat.runtime.usage import own_usage
from downbeat.tools.bench_control_world import standing_state
from downbeat.tools.control_journal import JOURNAL_NAME, ControlJournal
from downbeat.tools.show import Show, ShowConfig, make_control

TICK_US = 20_000
WARM_TICKS = 6_600
"""Black box and queues hold the last 10 s and turn over; measured: flat from 6000 ticks on."""
TICKS = 5_000
SKILLS = ("kpop", "stand", "thriller", "discostep")


class Stage:
    """Control as in a show, on fake time, asked for another skill every 3 s."""

    def __init__(self, folder):
        show = Show(ShowConfig(audio="", tracks="", index=""), folder)
        self.clock = SimClock()
        hub = MemqHub()
        self.sim = hub.endpoint("sim", self.clock)
        self.conductor = hub.endpoint("conductor", self.clock)
        core = ControlCore(SkillLibrary.load(only=frozenset(SKILLS)))
        self.journal = ControlJournal(folder / JOURNAL_NAME, show, core)
        bus = hub.endpoint("control", self.clock)
        self.node = make_control(show, bus, self.journal.record, None, core)
        self.state = standing_state()
        self.count = 0

    def run(self, ticks):
        for _ in range(ticks):
            self.clock.advance_to(self.clock.utime() + TICK_US)
            self.state.header.utime = self.clock.utime()
            for _ in range(2):
                self.sim.publish("G1_LOW_STATE", self.state)
            if self.count % 150 == 50:
                self.ask(SKILLS[self.count // 150 % len(SKILLS)])
            self.node.step(self.clock.utime())
            self.count += 1

    def ask(self, skill):
        msg = skill_request_t()
        msg.header.utime = self.clock.utime()
        msg.request_id, msg.skill, msg.phase_rate = self.count, skill, 1.0
        self.conductor.publish("SKILL_REQUEST", msg)


def growth(folder):
    """Return how many blocks and how much memory [kB] TICKS leave behind."""
    stage = Stage(folder)
    gc.collect()
    gc.disable()
    try:
        stage.run(WARM_TICKS)
        stage.run(TICKS)  # the allocator's own pages
        blocks, memory_kb = sys.getallocatedblocks(), own_usage().memory_kb
        stage.run(TICKS)
        return sys.getallocatedblocks() - blocks, own_usage().memory_kb - memory_kb
    finally:
        gc.enable()
        stage.journal.close()


def test_five_thousand_ticks_leave_nothing_behind(tmp_path):
    # In a process of its own: one that has run other tests takes a page now and then.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as own:
        more_blocks, more_kb = own.submit(growth, tmp_path).result(timeout=120.0)
    # One object left per tick would be 5000 blocks; 170 come and go with what the box holds.
    assert more_blocks < 1_000
    assert more_kb < 500


def test_policies_start_no_threads_that_could_spin():
    SkillLibrary.load(only=frozenset({"stand"}))  # the library's own first threads
    before = len(os.listdir("/proc/self/task"))
    library = SkillLibrary.load(only=frozenset(SKILLS))
    assert len(library.names) == len(SKILLS)
    assert len(os.listdir("/proc/self/task")) == before
