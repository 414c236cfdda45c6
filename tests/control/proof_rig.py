"""Atlases made by hand, and a core that is asked and answered without a bus."""

from typing import Any

import numpy as np
from control_rig import Rig

from downbeat.control.atlas import Atlas, Cell
from downbeat.control.core import ControlCore, CoreConfig
from downbeat.control.modes import modes_between
from downbeat.control.prover import ProofConfig
from downbeat.control.slots import entry_slots, exit_slots
from downbeat.lcm_types import transition_verdict_t
from downbeat.policies.manifest import load_skills

SKILLS = load_skills()


def cell(source: str, target: str, bound: float = 0.009, mode: str = "") -> Cell:
    """Return a cell with the same bound in every slot."""
    a, b = SKILLS[source], SKILLS[target]
    shape = (exit_slots(a).count, entry_slots(b).count)
    name = mode or modes_between(a, b)[0].name
    return Cell(source, target, name, np.full(shape, bound, np.float32), 384, 0)


def atlas_of(bound: float, *pairs: tuple[str, str], stand: float = 0.002) -> Atlas:
    """Return an atlas of the pairs, both ways, and of their ways to and from stand."""
    names = {name for pair in pairs for name in pair}
    cells = [cell(a, b, bound) for a, b in pairs] + [cell(b, a, bound) for a, b in pairs]
    cells += [cell(n, "stand", stand) for n in names] + [cell("stand", n, stand) for n in names]
    return Atlas(cells)


def verdict(query: Any, fallen: int = 0, count: int = 32) -> Any:
    """Return an answer to a query."""
    msg: Any = transition_verdict_t()
    msg.query_id = query.query_id
    msg.num_rollouts, msg.num_fallen = count, fallen
    msg.verdict = transition_verdict_t.UNSAFE if fallen > 2 else transition_verdict_t.SAFE
    return msg


class ProofRig(Rig):
    """A rig whose core proves, with a checker that answers what the test says."""

    def __init__(self, library: Any, atlas: Atlas, answer: Any = 0, delay_ticks: int = 5) -> None:
        """Answer every query with so many falls (or a function of it) some ticks later.

        None: never.
        """
        super().__init__(library)
        proof = ProofConfig(use_checker=True)
        self.core = ControlCore(library, CoreConfig(proof=proof), atlas)
        self.answer, self.delay = answer, delay_ticks
        self.queries: list[Any] = []
        self._due: list[tuple[int, Any]] = []

    def tick(self, requests: Any = (), **inputs: Any) -> Any:
        due = tuple(msg for tick, msg in self._due if tick <= self.tick_number)
        self._due = [one for one in self._due if one[0] > self.tick_number]
        output = super().tick(requests, verdicts=due, **inputs)
        if output.query is not None:
            self.queries.append(output.query)
            fallen = self.answer(output.query) if callable(self.answer) else self.answer
            if fallen is not None:
                self._due.append((self.tick_number + self.delay, verdict(output.query, fallen)))
        return output

    def words(self, request_id: int) -> list[tuple[int, str, str]]:
        """Return (state, plan, reason) of everything said about a request."""
        return [(c.state, c.plan, c.reason) for c in self.changes if c.key[1] == request_id]
