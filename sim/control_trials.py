"""Changes of skill through the real control core: random pairs, tempos and moments.

    python -m downbeat.sim.control_trials --trials 300

Every trial draws two skills, a tempo, a moment, mass and friction (nominal, +5 % / .57, -5 % /
.63) and noise; the first skill is asked for, then the second, both as soon as possible. The plant
is the show's: 2 ms steps, sensor noise, 4 ms command delay, torque limits. A fall is a base below
0.5 m within 6 s of the second request.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.control.core import ControlCore, TickInput
from downbeat.control.policy import SkillLibrary
from downbeat.lcm_types import skill_request_t
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.sim.lockstep import Lockstep
from downbeat.sim.node import SimNode
from downbeat.sim.plant import PlantConfig

VARIANTS = ((1.0, 0.6), (1.05, 0.57), (0.95, 0.63))
"""(mass, friction)."""
FALLEN_M = 0.5
WATCH_S = 6.0


@dataclass(frozen=True, slots=True)
class Trial:
    """One pair of skills and its seed."""

    source: str
    target: str
    seed: int


class _Driver:
    """Node "control" without a bus for requests: they are handed in."""

    name = "control"
    period_us = 20_000

    def __init__(self, bus: Any, core: ControlCore) -> None:
        self._bus = bus
        self.core = core
        self.requests: list[Any] = []
        self._tick = 0
        bus.subscribe("G1_LOW_STATE")

    def step(self, utime: int) -> None:
        self._bus.pump()
        latest = self._bus.latest("G1_LOW_STATE")
        state = None if latest is None else latest.msg
        age_us = 0 if latest is None else utime - latest.msg.header.utime
        requests, self.requests = tuple(self.requests), []
        output = self.core.tick(TickInput(utime, self._tick, state, age_us, requests))
        self._bus.publish("G1_LOW_CMD", output.command)
        self._tick += 1

    def close(self) -> None:
        """Nothing to release."""


def run_trial(library: SkillLibrary, trial: Trial) -> bool:
    """Return whether the robot fell."""
    rng = np.random.default_rng(trial.seed)
    mass, friction = VARIANTS[int(rng.integers(len(VARIANTS)))]
    clock = SimClock(SIM_EPOCH_UTIME)
    hub = MemqHub(trial.seed)
    config = PlantConfig(mass_scale=mass, friction=friction, seed=trial.seed)
    sim = SimNode(hub.endpoint("sim", clock), config)
    driver = _Driver(hub.endpoint("control", clock), ControlCore(library))
    scheduler = Lockstep(clock, (sim, driver))
    scheduler.run_until(clock.utime() + 1_000_000)
    bpm = float(rng.uniform(100.0, 140.0))
    moments = (0.0, float(rng.uniform(3.0, 8.0)))
    for number, (skill, wait_s) in enumerate(zip((trial.source, trial.target), moments), 1):
        scheduler.run_until(clock.utime() + round(wait_s * 50) * 20_000)
        driver.requests.append(_request(library, skill, number, clock.utime(), bpm))
    end = clock.utime() + round(WATCH_S * 1e6)
    while clock.utime() < end:
        scheduler.run_until(clock.utime() + 100_000)
        if not sim.plant.data.qpos[2] > FALLEN_M:
            return True
    return False


def _request(library: SkillLibrary, skill: str, number: int, now: int, bpm: float) -> Any:
    msg = skill_request_t()
    msg.request_id, msg.skill, msg.start_utime = number, skill, now
    built = library[skill].manifest.bpm
    msg.phase_rate = bpm / built if built > 0 else 1.0
    return msg


def make_trials(library: SkillLibrary, count: int, only: Sequence[str]) -> list[Trial]:
    """Draw pairs of different dances; with `only`, one of the two is of these kinds."""
    rng = np.random.default_rng(1)
    dances = [n for n in library.names if library[n].manifest.bpm > 0]
    kinds = {n: library[n].manifest.kind for n in dances}
    trials: list[Trial] = []
    while len(trials) < count:
        source, target = (str(n) for n in rng.choice(dances, 2, replace=False))
        if not only or kinds[source] in only:
            trials.append(Trial(source, target, len(trials)))
    return trials


def main() -> int:
    """Run from the command line; 0 if nobody fell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--skills", type=Path, default=None)
    parser.add_argument("--from-kind", action="append", default=[])
    args = parser.parse_args()
    library = SkillLibrary.load(args.skills)
    total: Counter[str] = Counter()
    fallen: Counter[str] = Counter()
    for trial in make_trials(library, args.trials, args.from_kind):
        kinds = (library[n].manifest.kind for n in (trial.source, trial.target))
        kind = " -> ".join(kinds)
        fell = run_trial(library, trial)
        total[kind] += 1
        fallen[kind] += fell
        if fell:
            print(f"fell: {trial.source} -> {trial.target} (seed {trial.seed})", flush=True)
    for kind in sorted(total):
        print(f"{kind}: {fallen[kind]} of {total[kind]}")
    return 1 if sum(fallen.values()) else 0


if __name__ == "__main__":
    raise SystemExit(main())
