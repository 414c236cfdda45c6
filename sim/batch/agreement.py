"""Do the engines agree? The same cells, robots and pushes on both; verdicts are compared.

    python -m downbeat.sim.batch.agreement --rollouts 64

Trajectories are not compared: after a contact two correct simulators part within seconds. What must
agree is how many robots fall. Cells are chosen so that 10 to 50 % do.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from downbeat.control.modes import BY_NAME
from downbeat.control.slots import entry_slots
from downbeat.policies.manifest import load_skills
from downbeat.sim.batch.cells import Change, entry_phases, simulate
from downbeat.sim.batch.engine import Engine, open_engine
from downbeat.sim.batch.perturb import BLOCK, Draws, draw_block, join_draws, load_profile
from downbeat.sim.batch.states import visit

SEED = 4711
CELLS = (
    ("kpop", "disco", "fade_0.3", (7.0, 8.0, 9.0)),
    ("boxstep", "waltz", "fade_0.3", (7.0, 8.0, 9.0)),
    ("stand", "discostep", "fade_0.3", (8.0, 10.0, 11.0)),
)
"""Source, target, mode, and the pushes [N s] at which 10 to 50 % fall."""
HORIZON_S = 2.2


@dataclass(frozen=True)
class CellAgreement:
    """One cell on both engines.

    Attributes:
        name: Change and push.
        count: Rollouts on each.
        native_fallen: Of these.
        mjx_fallen: Of these.
    """

    name: str
    count: int
    native_fallen: int
    mjx_fallen: int

    @property
    def difference(self) -> float:
        """Share that falls, MJX minus native."""
        return (self.mjx_fallen - self.native_fallen) / self.count

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval of the difference."""
        shares = [(k + 1) / (self.count + 2) for k in (self.native_fallen, self.mjx_fallen)]
        return 1.96 * math.sqrt(sum(p * (1.0 - p) / self.count for p in shares))


def pushed(draws: Draws, impulse_n_s: float) -> Draws:
    """Return the robots with a push of one strength within half a second of the change."""
    heading = np.arctan2(draws.push_n_s[:, 1], draws.push_n_s[:, 0])
    push = impulse_n_s * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return replace(draws, push_n_s=push, push_s=0.3 + draws.push_s / 3.0)


def compare(engines: Sequence[Engine], rollouts: int) -> list[CellAgreement]:
    """Run every cell on both engines.

    Args:
        engines: The native one and MJX.
        rollouts: Per cell, a multiple of 64.
    """
    skills, profile = load_skills(), load_profile()
    blocks = max(1, rollouts // BLOCK)
    found = []
    for source, target, mode, pushes in CELLS:
        a, b = skills[source], skills[target]
        for impulse in pushes:
            fallen, count = [0, 0], 0
            for block in range(blocks):
                calm = draw_block(profile, SEED, block)
                visits = visit(engines[0], a, calm, (SEED, block))
                rng = np.random.default_rng([SEED, block])
                exits = rng.integers(visits.slots.count, size=BLOCK)
                robots = np.flatnonzero(visits.valid[exits, np.arange(BLOCK)])
                entries = rng.integers(entry_slots(b).count, size=len(robots))
                phases = entry_phases(b, entries, rng)
                change = Change(robots, exits[robots], entries, phases)
                draws = pushed(join_draws([calm]), impulse)
                count += len(robots)
                for index, engine in enumerate(engines):
                    seed = (SEED, block, index)
                    outcome = simulate(
                        engine, visits, b, a, BY_NAME[mode], change, draws, seed, HORIZON_S
                    )
                    fallen[index] += outcome.num_fallen
            name = f"{source} -> {target}, push {impulse:.0f} N s"
            found.append(CellAgreement(name, count, *fallen))
            print(line(found[-1]), flush=True)
    return found


def line(cell: CellAgreement) -> str:
    """Return a row for people."""
    native, mjx = (k / cell.count for k in (cell.native_fallen, cell.mjx_fallen))
    return (
        f"{cell.name:36s} {cell.count:5d}  {native:6.1%}  {mjx:6.1%}  "
        f"{cell.difference:+6.1%} +- {cell.half_width:.1%}"
    )


def homogeneity(cells: Sequence[CellAgreement]) -> tuple[float, float]:
    """Return chi-squared over all cells and the chance of a larger one if the engines agree."""
    from scipy.stats import chi2

    total, degrees = 0.0, 0
    for cell in cells:
        pooled = (cell.native_fallen + cell.mjx_fallen) / (2.0 * cell.count)
        variance = 2.0 * pooled * (1.0 - pooled) / cell.count
        if variance > 0.0:
            total += cell.difference**2 / variance
            degrees += 1
    return total, float(chi2.sf(total, max(degrees, 1)))


def main() -> int:
    """Compare from the command line; 0 unless the engines plainly disagree."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rollouts", type=int, default=BLOCK, help="per cell")
    parser.add_argument("--engine", choices=("mjx", "warp"), default="mjx")
    parser.add_argument("--out", type=Path, default=None)
    args = parser.parse_args()
    skills = load_skills()
    engines = [open_engine("native", skills), open_engine(args.engine, skills)]
    print(f"{'change':36s} {'n':>5s}  {'native':>6s}  {args.engine:>6s}  difference (95 %)")
    cells = compare(engines, args.rollouts)
    total, chance = homogeneity(cells)
    count = sum(cell.count for cell in cells)
    native = sum(cell.native_fallen for cell in cells) / count
    mjx = sum(cell.mjx_fallen for cell in cells) / count
    print(f"all {count}: {native:.1%} and {mjx:.1%}; chi-squared {total:.1f}, p = {chance:.2f}")
    if args.out is not None:
        args.out.write_text(json.dumps([asdict(cell) for cell in cells]), encoding="utf-8")
    return 0 if chance > 0.001 else 1


if __name__ == "__main__":
    raise SystemExit(main())
