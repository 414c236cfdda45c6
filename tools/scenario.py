"""Traffic scenarios: what plays, what goes wrong, what must happen. One TOML file each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from downbeat.control.faults import FAULTS
from downbeat.lcm_types import skill_request_t, skill_status_t
from downbeat.runtime.bus_types import BusError
from downbeat.runtime.config import load_config
from downbeat.runtime.errors import one_of
from downbeat.runtime.traffic import Impairment, Injection
from downbeat.tools.errors import ToolError

CONDUCTOR_EPOCH = 77
MAX_SECONDS = 600.0
STATES = {v: k for k, v in vars(skill_status_t).items() if k.isupper() and isinstance(v, int)}
FAULT_NAMES = tuple(row.name for row in FAULTS)

Mode = Literal[
    "",
    "ZERO_TORQUE",
    "DAMPING",
    "MOVE_TO_POSE",
    "STAND",
    "SKILL",
    "TRANSITION",
    "FALLBACK",
    "ESTOP",
]


@dataclass(frozen=True, slots=True)
class Ask:
    """A skill request of the conductor.

    Attributes:
        at_s: When it is sent, scenario time [s].
        skill: Name.
        fields: Further fields of skill_request_t; `*_utime` are scenario seconds.
    """

    at_s: float
    skill: str = ""
    fields: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Shove:
    """A horizontal push on the torso for 0.1 s.

    Attributes:
        at_s: Start [s].
        impulse_n_s: [N s].
        direction_deg: World frame; 0 forwards, 90 to the left.
    """

    at_s: float
    impulse_n_s: float
    direction_deg: float = 0.0


@dataclass(frozen=True, slots=True)
class Expectation:
    """One thing that must be true; everything that is set must hold.

    Attributes:
        after_s: From here on [s].
        within_ms: Not later than this after `after_s`; 0: only at that moment.
        until_s: It must hold all the way to here [s]; 0: once is enough.
        mode: Control's mode.
        command: "position" or "damping": what the motors are told.
        skill: The active skill.
        fault: Name of the reported fault.
        no_fault: No fault is reported (until `until_s`).
        request: Id of a request that reaches `state`.
        state: SKILL_STATUS state's name.
        rejected_min: At least so many bad messages were counted by control at the end.
        lost_min: At least so many states were missed by control at the end.
        refused_min: At least so many bad messages were counted by the plant at the end.
        height_min_m: Of the pelvis, until `until_s`; a robot on its feet is above 0.6.
    """

    after_s: float = 0.0
    within_ms: float = 0.0
    until_s: float = 0.0
    mode: Mode = ""
    command: Literal["", "position", "damping", "zero_torque"] = ""
    skill: str = ""
    fault: str = ""
    no_fault: bool = False
    request: int = 0
    state: str = ""
    rejected_min: int = 0
    lost_min: int = 0
    refused_min: int = 0
    height_min_m: float = 0.0

    def check(self, seconds: float) -> None:
        """Refuse what makes no sense.

        Args:
            seconds: When the scenario ends [s].

        Raises:
            ToolError: A name is unknown, a time is outside, or nothing is expected.
        """
        last_s = max(self.until_s, self.after_s + self.within_ms * 1e-3)
        if self.after_s < 0.0 or self.within_ms < 0.0 or not last_s <= seconds:
            raise ToolError(
                f"It looks at {self.after_s:g} to {last_s:g} s; the scenario ends at {seconds:g} s."
            )
        if 0.0 < self.until_s <= self.after_s + self.within_ms * 1e-3:
            raise ToolError(f"until_s is {self.until_s:g}; it ends before it starts.")
        if self.fault and self.fault not in FAULT_NAMES:
            raise ToolError(f"fault '{self.fault}' is unknown; faults are {one_of(FAULT_NAMES)}.")
        if self.state and self.state not in STATES.values():
            raise ToolError(
                f"state '{self.state}' is unknown; states are {one_of(STATES.values())}."
            )
        if bool(self.request) != bool(self.state):
            raise ToolError("request and state belong together; one of them is missing.")
        times = {"after_s", "within_ms", "until_s"}
        if not any(getattr(self, name) for name in self.__slots__ if name not in times):
            raise ToolError("Nothing is expected; valid is e.g. mode = 'DAMPING'.")


@dataclass(frozen=True, slots=True)
class Scenario:
    """A scenario file.

    Attributes:
        sentence: What happens, for people.
        seconds: Length [s]; control stands by itself at 1 s.
        ask: Requests.
        impair: What happens to messages on the way.
        inject: Messages of other publishers.
        push: Shoves.
        expect: What must be true.
        commands_unchanged: Every command is byte-identical to the run without impair and inject.
        seed: Of everything random, and of the plant's noise.
        skills: Loaded besides "stand"; empty: those that are asked for.
        pending: Why it does not hold yet; empty: it must.
        may_command_motors: G1_LOW_CMD may be injected on a running bus, too.
    """

    sentence: str
    seconds: float
    ask: tuple[Ask, ...] = ()
    impair: tuple[Impairment, ...] = ()
    inject: tuple[Injection, ...] = ()
    push: tuple[Shove, ...] = ()
    expect: tuple[Expectation, ...] = ()
    commands_unchanged: bool = False
    seed: int = 0
    skills: tuple[str, ...] = ()
    pending: str = ""
    may_command_motors: bool = False

    @property
    def needed_skills(self) -> frozenset[str]:
        """Skills that must be loaded."""
        named = self.skills or tuple(one.skill for one in self.ask if one.skill)
        return frozenset({"stand", *named})

    @property
    def requests(self) -> tuple[Injection, ...]:
        """The asks as messages of one conductor, numbered from 1."""
        found = []
        for number, ask in enumerate(self.ask, start=1):
            defaults: dict[str, Any] = {
                "request_id": number,
                "skill": ask.skill,
                "phase_rate": 1.0,
                "start_utime": ask.at_s,
                "source": skill_request_t.SOURCE_MUSIC,
            }
            fields = {**defaults, **ask.fields}
            found.append(Injection("SKILL_REQUEST", ask.at_s, fields=fields, epoch=CONDUCTOR_EPOCH))
        return tuple(found)


def load_scenario(path: Path) -> Scenario:
    """Read a scenario.

    Raises:
        DownbeatError: Not TOML, an unknown key, a wrong type or an impossible value (file:key).
    """
    scenario = load_config(path, Scenario)
    if not 0.0 < scenario.seconds <= MAX_SECONDS:  # also catches a NaN
        raise ToolError(
            f"{path}:seconds is {scenario.seconds}; valid are more than 0 to {MAX_SECONDS:g}."
        )
    if not scenario.sentence.strip().endswith("."):
        raise ToolError(f"{path}:sentence must be one sentence, with a full stop.")
    if not scenario.expect and not scenario.commands_unchanged:
        raise ToolError(f"{path}:expect is missing; a scenario must expect something.")
    for index, one in enumerate(scenario.expect):
        try:
            one.check(scenario.seconds)
        except ToolError as error:
            raise ToolError(f"{path}:expect[{index}]: {error}") from error
    _check_traffic(path, "ask", scenario.requests, scenario.seconds)
    _check_traffic(path, "inject", scenario.inject, scenario.seconds)
    _check_traffic(path, "impair", scenario.impair, scenario.seconds)
    for index, push in enumerate(scenario.push):
        values = (push.at_s, push.impulse_n_s, push.direction_deg)
        if not all(math.isfinite(value) for value in values) or push.at_s > scenario.seconds:
            raise ToolError(f"{path}:push[{index}] is not finite, or after the scenario's end.")
    return scenario


def _check_traffic(
    path: Path, key: str, plan: Sequence[Impairment | Injection], seconds: float
) -> None:
    """Refuse impossible traffic, with file and key."""
    for index, one in enumerate(plan):
        try:
            one.check()
        except BusError as error:
            raise ToolError(f"{path}:{key}[{index}]: {error}") from error
        first_s = one.from_s if isinstance(one, Impairment) else one.at_s
        if first_s >= seconds:
            raise ToolError(
                f"{path}:{key}[{index}] begins at {first_s:g} s; "
                f"the scenario ends at {seconds:g} s."
            )
