"""The measured process of `downbeat bench control`: control as in a show, or its network alone.

A process of its own: `python -m downbeat.tools.bench_control_worker SETTINGS.json`. It loads every
bundled skill once, then runs one block per line of standard input, `{"kind": ..., "seconds": ...}`,
and answers each with one line of JSON.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.control.core import ControlCore, TickInput, TickOutput
from downbeat.control.phase import TICK_US
from downbeat.control.policy import SkillLibrary
from downbeat.control.session import WARM_UP_CALLS, open_session
from downbeat.lcm_types import skill_request_t
from downbeat.policies.manifest import load_skills
from downbeat.runtime.bus import MemqHub, open_udpm
from downbeat.runtime.clock import SimClock, WallClock
from downbeat.runtime.config import load_config
from downbeat.runtime.node import run_node
from downbeat.runtime.rate import RateKeeper
from downbeat.runtime.realtime import RealTimeReport, configure_real_time
from downbeat.runtime.usage import own_usage
from downbeat.tools.bench_control_world import (
    STATE_PERIOD_US,
    BenchSettings,
    standing_state,
    tremble,
)
from downbeat.tools.control_journal import JOURNAL_NAME, ControlJournal
from downbeat.tools.show import Show, ShowConfig, make_control

WARM_SKIPPED_TICKS = 50
"""Until the skill plays alone."""


@dataclass(frozen=True)
class BlockResult:
    """What one block measured; lists have one entry per tick.

    Attributes:
        kind: "control", "network", or "warm" (control back to back, without sleep).
        start_utime: First moment of the block [us].
        end_utime: Last one [us].
        lateness_us: Wake-up after the deadline, multiples of 20 ms of the time base [us].
        compute_us: control: the whole tick, from wake-up to sleep; network: its run alone [us].
        network_us: Time inside ONNX Runtime in that very tick [us].
        missed: Deadlines given up.
        cpu_s: Processor time of the whole process in the block [s].
        memory_kb: Resident memory at the block's end [KiB].
        faults: Ticks with a fault.
    """

    kind: str
    start_utime: int
    end_utime: int
    lateness_us: list[float]
    compute_us: list[float]
    network_us: list[float]
    missed: int
    cpu_s: float
    memory_kb: int
    faults: int = 0


class NetworkMeter:
    """Times the networks of a library where they run, inside control's tick."""

    def __init__(self, library: SkillLibrary) -> None:
        self.spent_ns = 0
        for name in library.names:
            skill: Any = library[name]
            skill.session = _MeteredSession(skill.session, self)

    def take_us(self) -> float:
        """Return what was spent since the last call [us]."""
        spent, self.spent_ns = self.spent_ns, 0
        return spent * 1e-3


class _MeteredSession:
    def __init__(self, session: Any, meter: NetworkMeter) -> None:
        self._session = session
        self._meter = meter

    def run(self, outputs: Any, feeds: Any) -> Any:
        before = time.perf_counter_ns()
        result = self._session.run(outputs, feeds)
        self._meter.spent_ns += time.perf_counter_ns() - before
        return result


class TickNotes:
    """Stands between control and its journal; notes what each tick spent in networks."""

    def __init__(self, journal: ControlJournal, meter: NetworkMeter) -> None:
        self._journal = journal
        self._meter = meter
        self.network_us: list[float] = []
        self.faults = 0

    def record(self, inputs: TickInput, output: TickOutput) -> None:
        """Write the tick's record as in a show, and note."""
        self._journal.record(inputs, output)
        self.network_us.append(self._meter.take_us())
        self.faults += bool(output.status.fault)


class NetworkNode:
    """The skill's network at control's cadence, and nothing else."""

    name = "control"
    period_us = TICK_US

    def __init__(self, path: Path) -> None:
        """Open a policy file and warm it."""
        self._session = open_session(path)
        self._outputs = [self._session.get_outputs()[0].name]
        self._feeds = {
            node.name: np.zeros([d if isinstance(d, int) else 1 for d in node.shape], np.float32)
            for node in self._session.get_inputs()
        }
        self.run_us: list[float] = []
        for _ in range(WARM_UP_CALLS):
            self._session.run(self._outputs, self._feeds)

    def step(self, utime: int) -> None:
        """Run once."""
        before = time.perf_counter_ns()
        self._session.run(self._outputs, self._feeds)
        self.run_us.append((time.perf_counter_ns() - before) * 1e-3)

    def close(self) -> None:
        """Nothing to release."""


class WarmStage:
    """Control as in a show but on the bus inside the process, playing the skill all the time."""

    def __init__(self, show: Show, library: SkillLibrary, skill: str, meter: NetworkMeter) -> None:
        self._clock = SimClock()
        hub = MemqHub()
        core = ControlCore(library)
        self._journal = ControlJournal(show.path(JOURNAL_NAME), show, core)
        self.notes = TickNotes(self._journal, meter)
        self._sim = hub.endpoint("sim", self._clock)
        self._conductor = hub.endpoint("conductor", self._clock)
        bus = hub.endpoint("control", self._clock)
        self._node = make_control(show, bus, self.notes.record, None, core)
        self._state = standing_state()
        self._tick()
        msg: Any = skill_request_t()
        msg.header.utime = self._clock.utime()
        msg.request_id, msg.skill, msg.phase_rate = 1, skill, 1.0
        self._conductor.publish("SKILL_REQUEST", msg)
        for _ in range(WARM_SKIPPED_TICKS):
            self._tick()
        self.notes.network_us.clear()

    def _tick(self) -> float:
        for _ in range(TICK_US // STATE_PERIOD_US):
            self._clock.advance_to(self._clock.utime() + STATE_PERIOD_US)
            self._state.header.utime = self._clock.utime()
            tremble(self._state, self._clock.utime())
            self._sim.publish("G1_LOW_STATE", self._state)
        before = time.perf_counter_ns()
        self._node.step(self._clock.utime())
        return (time.perf_counter_ns() - before) * 1e-3

    def run(self, ticks: int) -> list[float]:
        """Return the duration of each tick [us]."""
        return [self._tick() for _ in range(ticks)]

    def close(self) -> None:
        """Finish the journal."""
        self._node.close()
        self._journal.close()


class Worker:
    """Runs blocks."""

    def __init__(self, settings: BenchSettings, folder: Path) -> None:
        """Load and warm everything.

        Raises:
            DownbeatError: A skill cannot be loaded.
        """
        self._settings = settings
        self._clock: WallClock = settings.clock
        self._show = Show(ShowConfig(audio="", tracks="", index=""), folder)
        self._library = SkillLibrary.load()
        self._meter = NetworkMeter(self._library)
        self._network = load_skills()[settings.skill].onnx_path
        self.granted: RealTimeReport | None = None

    def run(self, kind: str, seconds: float) -> BlockResult:
        """Run one block."""
        blocks = {"control": self._control, "network": self._run_network, "warm": self._run_warm}
        return blocks[kind](seconds)

    def _control(self, seconds: float) -> BlockResult:
        bus = open_udpm(self._settings.url, self._clock, "control")
        core = ControlCore(self._library)
        journal = ControlJournal(self._show.path(JOURNAL_NAME), self._show, core)
        notes = TickNotes(journal, self._meter)
        keeper = RateKeeper(self._clock, TICK_US)
        node = make_control(self._show, bus, notes.record, keeper.timing, core)
        start, cpu_s = self._begin()
        try:
            end = start + round(seconds * 1e6)
            run_node(node, self._clock, bus, rate=keeper, end_utime=end)
        finally:
            journal.close()
            bus.close()
        compute = [float(value) for value in keeper.compute.samples()]
        return self._result("control", start, cpu_s, keeper, compute, notes)

    def _run_network(self, seconds: float) -> BlockResult:
        node = NetworkNode(self._network)
        keeper = RateKeeper(self._clock, TICK_US)
        start, cpu_s = self._begin()
        run_node(node, self._clock, rate=keeper, end_utime=start + round(seconds * 1e6))
        return self._result("network", start, cpu_s, keeper, node.run_us)

    def _run_warm(self, seconds: float) -> BlockResult:
        """Step control without sleep on simulated time: what the code costs with warm caches."""
        stage = WarmStage(self._show, self._library, self._settings.skill, self._meter)
        start, cpu_s = self._begin()
        keeper = RateKeeper(self._clock, TICK_US)
        compute_us = stage.run(max(2, round(seconds * 1e6) // TICK_US))
        result = self._result("warm", start, cpu_s, keeper, compute_us, stage.notes)
        stage.close()
        return result

    def _begin(self) -> tuple[int, float]:
        """Take real-time rights, as control does before its first tick; start counting."""
        settings = self._settings
        gc.unfreeze()  # the block before is over: let the collection below have what it left
        self.granted = configure_real_time(
            settings.priority, cpu=None if settings.cpu < 0 else settings.cpu
        )
        return self._clock.utime(), time.process_time()

    def _result(
        self,
        kind: str,
        start: int,
        cpu_s: float,
        keeper: RateKeeper,
        compute_us: list[float],
        notes: TickNotes | None = None,
    ) -> BlockResult:
        ticks = len(compute_us)  # the wake-up that ended the block was no tick
        return BlockResult(
            kind=kind,
            start_utime=start,
            end_utime=self._clock.utime(),
            lateness_us=[float(value) for value in keeper.lateness.samples()[:ticks]],
            compute_us=compute_us,
            network_us=[0.0] * ticks if notes is None else notes.network_us[:ticks],
            missed=keeper.missed,
            cpu_s=time.process_time() - cpu_s,
            memory_kb=own_usage().memory_kb,
            faults=0 if notes is None else notes.faults,
        )


def main(argv: list[str]) -> int:
    """Answer lines until standard input ends."""
    settings = load_config(Path(argv[1]), BenchSettings)
    with tempfile.TemporaryDirectory() as folder:
        worker = Worker(settings, Path(folder))
        _say({"ready": True, "pid": os.getpid()})
        for line in sys.stdin:
            asked = json.loads(line)
            result: dict[str, Any] = asdict(worker.run(asked["kind"], asked["seconds"]))
            _say({**result, "granted": asdict(worker.granted) if worker.granted else None})
    return 0


def _say(answer: dict[str, Any]) -> None:
    print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv))
