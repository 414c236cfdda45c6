"""Run a show in lockstep: one process, simulated time, byte-identical from the same seed."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.runtime.log import LogWriter
from downbeat.sim.lockstep import Lockstep
from downbeat.tools.control_journal import JOURNAL_NAME, ControlJournal
from downbeat.tools.show import (
    Show,
    make_checker,
    make_conductor,
    make_control,
    make_core,
    make_listener,
    make_sim,
    make_speech,
)

LEAD_US = 3_000_000
"""The robot stands for this long before the music starts."""
TAIL_US = 3_000_000


def run_lockstep(
    show: Show,
    run_dir: Path,
    duration_s: float,
    on_second: Callable[[int, float], None] | None = None,
) -> float:
    """Run to the end of the music and a little on; writes run.lcmlog and journal.

    Args:
        show: The show.
        run_dir: Where the log goes.
        duration_s: Length of the sound [s].
        on_second: Progress: (simulated seconds done, total).

    Returns:
        Simulated seconds per second of processor time.
    """
    clock = SimClock(SIM_EPOCH_UTIME)
    hub = MemqHub(seed=show.config.seed)
    log = LogWriter(run_dir / "run.lcmlog")
    hub.tap(log.write)
    start = clock.utime()
    first_sample_utime = start + LEAD_US
    core = make_core(show)
    journal = ControlJournal(run_dir / JOURNAL_NAME, show, core)
    nodes = (
        make_sim(show, hub.endpoint("sim", clock)),
        make_listener(show, hub.endpoint("listener", clock), first_sample_utime),
        make_conductor(show, hub.endpoint("conductor", clock)),
        make_control(show, hub.endpoint("control", clock), journal.record, core=core),
    )
    checker = make_checker(show, hub.endpoint("checker", clock), is_simulated_time=True)
    speech = make_speech(show, hub.endpoint("speech", clock), first_sample_utime, True)
    more = tuple(node for node in (speech, checker) if node is not None)
    scheduler = Lockstep(clock, (*nodes, *more))
    total_us = LEAD_US + round(duration_s * 1e6) + TAIL_US

    def progress(utime: int) -> bool:
        if on_second is not None:
            on_second((utime - start) // 1_000_000, total_us * 1e-6)
        return True

    before = time.process_time()
    try:
        scheduler.run_until(start + total_us, progress)
    finally:
        spent_s = time.process_time() - before
        scheduler.close()
        journal.close()
        log.close()
    return total_us * 1e-6 / max(spent_s, 1e-9)
