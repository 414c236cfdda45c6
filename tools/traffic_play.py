"""Play a scenario in lockstep: the real control and the real plant, a bad network in between."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from downbeat.control.core import ControlCore, TickInput, TickOutput
from downbeat.control.node import ControlNode
from downbeat.control.policy import SkillLibrary
from downbeat.control.record import COMPARED, input_of, tick_record
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.runtime.errors import one_of
from downbeat.runtime.traffic import Impairer, Injector
from downbeat.sim.lockstep import STEP_US, Lockstep
from downbeat.sim.node import SimNode
from downbeat.sim.plant import PlantConfig
from downbeat.tools.errors import ToolError
from downbeat.tools.scenario import Scenario, Shove
from downbeat.tools.traffic_judge import Outcome, Seen, compare, judge, judge_always

PUSH_S = 0.1


class _InjectorNode:
    """Publishes the injected messages at their time."""

    name = "traffic"
    period_us = STEP_US

    def __init__(self, hub: MemqHub, injector: Injector) -> None:
        self._hub = hub
        self._injector = injector

    def step(self, utime: int) -> None:
        """Publish what is due."""
        for _, channel, payload in self._injector.take(utime):
            self._hub.deliver(utime, channel, payload)

    def close(self) -> None:
        """Nothing to release."""


class _Pusher:
    """Shoves the robot at the asked times."""

    name = "pusher"
    period_us = STEP_US

    def __init__(self, sim: SimNode, pushes: Sequence[Shove], start_utime: int) -> None:
        self._data = sim.plant.data
        self._body = sim.plant.model.body("torso_link").id
        self._pushes = pushes
        self._start = start_utime

    def step(self, utime: int) -> None:
        """Set the force of this moment."""
        time_s = (utime - self._start) * 1e-6
        force = [0.0, 0.0]
        for push in self._pushes:
            if push.at_s - 1e-9 <= time_s < push.at_s + PUSH_S - 1e-9:
                angle = math.radians(push.direction_deg)
                force[0] += push.impulse_n_s / PUSH_S * math.cos(angle)
                force[1] += push.impulse_n_s / PUSH_S * math.sin(angle)
        self._data.xfrc_applied[self._body, :2] = force

    def close(self) -> None:
        """Nothing to release."""


def run_scenario(scenario: Scenario, library: SkillLibrary) -> Outcome:
    """Play a scenario in lockstep over memq, with the real control and the real plant, and judge.

    Args:
        scenario: What happens.
        library: Holds at least the scenario's skills.

    Raises:
        ToolError: The library lacks one of them.
    """
    missing = scenario.needed_skills - set(library.names)
    if missing:
        raise ToolError(
            f"Skill '{min(missing)}' is unknown; skills are {one_of(library.names)} (ask.skill; a "
            "scenario that asks for an unknown one on purpose lists the known ones in skills)."
        )
    outcome = _play(scenario, library)
    outcome.problems += judge_always(outcome)
    for one in scenario.expect if outcome.ticks else ():
        outcome.problems += judge(one, outcome)
    if scenario.commands_unchanged:
        calm = _play(replace(scenario, impair=(), inject=()), library)
        outcome.problems += compare(outcome, calm)
    outcome.problems += _replay(outcome, library)
    return outcome


def _play(scenario: Scenario, library: SkillLibrary) -> Outcome:
    clock = SimClock(SIM_EPOCH_UTIME)
    start = clock.utime()
    hub = MemqHub(scenario.seed)
    impairer = Impairer(scenario.impair, start, scenario.seed)
    if scenario.impair:
        hub.impair(impairer)
    outcome = Outcome()

    def journal(inputs: TickInput, output: TickOutput) -> None:
        outcome.records.append(tick_record(inputs, output))
        height = sim.plant.base_height
        seen = Seen((inputs.utime - start) * 1e-6, output.status, output.command, height)
        outcome.ticks.append(seen)
        for change in output.changes:
            outcome.add_change(change.key[1], change.state, change.reason)

    sim_bus = hub.endpoint("sim", clock)
    sim = SimNode(sim_bus, PlantConfig(seed=scenario.seed))
    control = ControlNode(hub.endpoint("control", clock), ControlCore(library), journal)
    injections = (*scenario.requests, *scenario.inject)
    pusher = _Pusher(sim, scenario.push, start)
    traffic = _InjectorNode(hub, Injector(injections, start, scenario.seed))
    scheduler = Lockstep(clock, (traffic, pusher, sim, control))
    try:
        scheduler.run_until(start + round(scenario.seconds * 1e6))
    except Exception as error:  # a process that dies is the worst that can happen: report it
        time_s = (clock.utime() - start) * 1e-6
        kind = type(error).__name__
        outcome.problems.append(f"A process died at {time_s:.2f} s: {kind}: {error}")
    scheduler.close()
    counters = sim_bus.counters
    foreign = counters.foreign_on("G1_LOW_CMD")
    outcome.problems += [
        f"impair[{index}] never met a message."
        for index, count in enumerate(impairer.touched)
        if not count and not outcome.problems
    ]
    outcome.refused = counters.rejected + foreign + sim.plant.counters.refused
    return outcome


def _replay(outcome: Outcome, library: SkillLibrary) -> list[str]:
    """Every scenario replays bit for bit, whatever it does to the bus."""
    core = ControlCore(library)
    for record in outcome.records:
        inputs = input_of(record)
        again = tick_record(inputs, core.tick(inputs))
        for name in COMPARED:
            if record.get(name) != again.get(name) and record.get(name) == record.get(name):
                return [f"Replay differs at tick {record['tick']} in {name}."]
    return []
