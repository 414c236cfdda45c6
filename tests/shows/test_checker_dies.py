"""A show whose checker is killed in the middle: nobody falls, nothing waits, control goes on."""

import numpy as np
import pytest

from downbeat.control.atlas import BUNDLED_ATLAS
from downbeat.control.core import ControlCore, CoreConfig
from downbeat.control.node import ControlNode
from downbeat.control.policy import SkillLibrary
from downbeat.control.prover import ProofConfig
from downbeat.lcm_types import skill_request_t, skill_status_t
from downbeat.policies.manifest import load_skills
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.sim.checker import Checker, CheckerNode
from downbeat.sim.lockstep import Lockstep
from downbeat.sim.node import SimNode
from downbeat.sim.plant import PlantConfig

SKILLS = ("stand", "kpop", "discostep", "salsa", "disco")
DANCES = ("kpop", "discostep", "salsa", "disco", "kpop", "salsa", "discostep", "disco")
SECTION_S = 4.0

pytestmark = pytest.mark.skipif(not BUNDLED_ATLAS.exists(), reason="no bundled atlas")


class Mortal:
    """A checker that stops for good at some time, in whatever it was doing."""

    name, period_us = "checker", 20_000

    def __init__(self, node, dies_utime):
        self._node, self._dies = node, dies_utime

    def step(self, utime):
        if utime < self._dies:
            self._node.step(utime)

    def close(self):
        self._node.close()


def show(dies_after_s):
    """Dance announced sections; return heights, statuses and per-tick wall-free facts."""
    from downbeat.control.atlas import Atlas

    manifests = {n: m for n, m in load_skills().items() if n in SKILLS}
    atlas = Atlas.load(BUNDLED_ATLAS, manifests)
    proof = ProofConfig(use_checker=True, rollouts=8, horizon_s=1.0)
    clock, hub = SimClock(SIM_EPOCH_UTIME), MemqHub(5)
    sim = SimNode(hub.endpoint("sim", clock), PlantConfig(seed=5))
    core = ControlCore(SkillLibrary.load(only=frozenset(SKILLS)), CoreConfig(proof=proof), atlas)
    control = ControlNode(hub.endpoint("control", clock), core)
    checker = CheckerNode(
        hub.endpoint("checker", clock), Checker(manifests, atlas, proof, threads=1), True
    )
    begin = clock.utime() + 2_000_000
    mortal = Mortal(checker, begin + round(dies_after_s * 1e6))
    operator = hub.endpoint("operator", clock)
    operator.subscribe("SKILL_STATUS", "CONTROL_STATUS")
    scheduler = Lockstep(clock, (sim, control, mortal))
    scheduler.run_until(begin)
    heights, said, ticks = [], [], []
    for number, skill in enumerate(DANCES):
        msg = skill_request_t()
        msg.request_id, msg.skill, msg.phase_rate = number + 1, skill, 1.0
        msg.start_utime = begin + round((1.0 + number * SECTION_S) * 1e6)
        msg.source = skill_request_t.SOURCE_OPERATOR
        msg.header.utime = clock.utime()
        operator.publish("OPERATOR_SKILL_REQUEST", msg)
        until = begin + round((1.0 + (number + 0.3) * SECTION_S) * 1e6)
        while clock.utime() < until:
            scheduler.run_until(clock.utime() + 20_000)
            heights.append(float(sim.plant.data.qpos[2]))
            operator.pump()
            said += [r.msg for r in operator.take("SKILL_STATUS")]
            ticks += [r.msg for r in operator.take("CONTROL_STATUS")]
    onsets = {}
    for msg in said:
        if msg.state == skill_status_t.RUNNING:
            wanted = begin + round((1.0 + (msg.request_id - 1) * SECTION_S) * 1e6)
            onsets.setdefault(int(msg.request_id), (msg.onset_utime - wanted) * 1e-6)
    plans = {int(m.request_id): m.plan for m in said if m.state == skill_status_t.RUNNING}
    return np.array(heights), onsets, plans, ticks


@pytest.mark.slow
def test_killing_the_checker_costs_no_fall_no_tick_and_no_section():
    heights, onsets, plans, ticks = show(dies_after_s=9.0)
    assert heights.min() > 0.6
    assert np.all(np.diff([t.tick for t in ticks]) == 1)
    assert set(onsets) == set(range(1, len(DANCES) + 1))
    assert max(abs(v) for k, v in onsets.items() if k > 1) < 0.25  # footwork waits for its beat
    assert "blended" in [plans[k] for k in (2, 3)]


@pytest.mark.slow
def test_with_the_checker_alive_the_changes_are_made_straight_away():
    heights, onsets, plans, _ = show(dies_after_s=1e6)
    assert heights.min() > 0.6
    assert [plans[k] for k in range(2, len(DANCES) + 1)].count("blended") >= 6
    assert max(abs(v) for k, v in onsets.items() if k > 1) <= 0.04
