"""Traffic scenarios: what plays, what goes wrong, what must happen. One TOML file each."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from downbeat.runtime.config import load_config
from downbeat.runtime.traffic import Impairment, Injection
from downbeat.tools.errors import ToolError

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
        request: Id of a request that ends in `state`.
        state: SKILL_STATUS state's name that the request reaches.
        rejected_min: At least so many bad messages were counted at the end.
        lost_min: At least so many states were missed at the end.
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
    height_min_m: float = 0.0


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

    @property
    def needed_skills(self) -> frozenset[str]:
        """Skills that must be loaded."""
        named = self.skills or tuple(one.skill for one in self.ask if one.skill)
        return frozenset({"stand", *named})


def load_scenario(path: Path) -> Scenario:
    """Read a scenario.

    Raises:
        DownbeatError: Not TOML, an unknown key, a wrong type or an impossible time (file:key).
    """
    scenario = load_config(path, Scenario)
    if not 0.0 < scenario.seconds <= 600.0 or not math.isfinite(scenario.seconds):
        raise ToolError(f"{path}:seconds is {scenario.seconds}; valid are more than 0 to 600.")
    if not scenario.sentence.strip().endswith("."):
        raise ToolError(f"{path}:sentence must be one sentence, with a full stop.")
    if not scenario.expect and not scenario.commands_unchanged:
        raise ToolError(f"{path}:expect is missing; a scenario must expect something.")
    for index, one in enumerate(scenario.expect):
        if one.after_s > scenario.seconds or one.until_s > scenario.seconds:
            raise ToolError(
                f"{path}:expect[{index}] looks at {max(one.after_s, one.until_s):g} s, the "
                f"scenario ends at {scenario.seconds:g} s."
            )
    return scenario
