"""One skill through the real control core on the plant, recorded tick by tick, pushed if wanted.

What the state estimate and the fall prediction are measured on: what control could have known
(`Sample.state`), beside what was true (`Sample.qpos`, `Sample.qvel`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.control.core import ControlCore, TickInput
from downbeat.control.policy import SkillLibrary
from downbeat.lcm_types import skill_request_t
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.sim.lockstep import Lockstep
from downbeat.sim.node import SimNode
from downbeat.sim.noise import NoiseConfig
from downbeat.sim.plant import PlantConfig

F64 = NDArray[np.float64]

TICK_US = 20_000
STAND_S = 1.0
"""The gantry lets go within half of this."""
PUSH_S = 0.1
PUSHED_BODY = "torso_link"


@dataclass(frozen=True, slots=True)
class Push:
    """A constant horizontal force on the torso for 0.1 s.

    Attributes:
        impulse_n_s: [N s].
        direction_rad: World frame; 0 forwards, pi/2 to the left.
        start_s: After the skill was asked for.
    """

    impulse_n_s: float
    direction_rad: float
    start_s: float


@dataclass(frozen=True, slots=True)
class MotionTrial:
    """What is played, on which robot.

    Attributes:
        skill: Name.
        seconds: To record, from the request on.
        mass_scale: Factor on the torso's mass.
        friction: Of the soles.
        seed: Of the noise.
        velocity: vx, vy [m/s], yaw rate [rad/s], for locomotion.
        phase_rate: Skill seconds per second.
        then: A second skill, asked for `then_s` after the first; empty: none.
        then_s: [s].
        push: None: nobody pushes.
        noise: Of the sensors.
        command_delay_us: From a command to its effect on the motors [us].
        duration_s: The skill is asked for so long [s]; 0: to its end, or for ever.
    """

    skill: str
    seconds: float = 12.0
    mass_scale: float = 1.0
    friction: float = 0.6
    seed: int = 0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    phase_rate: float = 1.0
    then: str = ""
    then_s: float = 6.0
    push: Push | None = None
    noise: NoiseConfig = field(default_factory=NoiseConfig)
    command_delay_us: int = 4_000
    duration_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Sample:
    """One control tick.

    Attributes:
        time_s: Since the skill was asked for.
        state: The g1_low_state_t that control saw.
        status: The control_status_t of the tick.
        qpos: (36,) true.
        qvel: (35,) true.
    """

    time_s: float
    state: Any
    status: Any
    qpos: F64
    qvel: F64


class _Driver:
    """Node "control" that keeps what its core saw; requests are handed in."""

    name = "control"
    period_us = TICK_US

    def __init__(self, bus: Any, core: ControlCore) -> None:
        self._bus = bus
        self._core = core
        self._tick = 0
        self.requests: list[Any] = []
        self.seen: tuple[Any, Any] | None = None
        bus.subscribe("G1_LOW_STATE")

    def step(self, utime: int) -> None:
        self._bus.pump()
        latest = self._bus.latest("G1_LOW_STATE")
        requests, self.requests = tuple(self.requests), []
        state = None if latest is None else latest.msg
        age_us = 0 if latest is None else utime - latest.msg.header.utime
        output = self._core.tick(TickInput(utime, self._tick, state, age_us, requests))
        self._bus.publish("G1_LOW_CMD", output.command)
        self.seen = (state, output.status)
        self._tick += 1

    def close(self) -> None:
        """Nothing to release."""


def play(
    library: SkillLibrary, trial: MotionTrial, core: ControlCore | None = None
) -> Iterator[Sample]:
    """Play a trial; every tick from the release of the robot on, time below 0 before the request.

    Args:
        library: The skills.
        trial: What to do.
        core: A fresh one that plays the library; None: with its default settings.

    Raises:
        SimError: A setting is impossible.
    """
    clock = SimClock(SIM_EPOCH_UTIME)
    hub = MemqHub(trial.seed)
    config = PlantConfig(
        mass_scale=trial.mass_scale,
        friction=trial.friction,
        noise=trial.noise,
        seed=trial.seed,
        command_delay_us=trial.command_delay_us,
    )
    sim = SimNode(hub.endpoint("sim", clock), config)
    driver = _Driver(hub.endpoint("control", clock), core or ControlCore(library))
    scheduler = Lockstep(clock, (sim, driver))
    asked_utime = clock.utime() + round(STAND_S * 1e6)
    plant = sim.plant
    body = plant.model.body(PUSHED_BODY).id
    requests = _requests(trial, asked_utime)
    while clock.utime() < asked_utime + round(trial.seconds * 1e6):
        driver.requests += requests.pop(clock.utime(), [])
        time_s = (clock.utime() - asked_utime) * 1e-6
        plant.data.xfrc_applied[body, :2] = _force(trial.push, time_s)
        scheduler.run_until(clock.utime() + TICK_US)
        if driver.seen is not None and driver.seen[0] is not None:
            qpos, qvel = plant.data.qpos.copy(), plant.data.qvel.copy()
            yield Sample(time_s + TICK_US * 1e-6, *driver.seen, qpos, qvel)


def _requests(trial: MotionTrial, utime: int) -> dict[int, list[Any]]:
    """Return what is asked for and when [us]; stand needs no asking."""
    asked: dict[int, list[Any]] = {}
    wanted = ((trial.skill, utime), (trial.then, utime + round(trial.then_s * 50) * TICK_US))
    for number, (skill, when) in enumerate(wanted, 1):
        if skill in ("", "stand"):
            continue
        msg = skill_request_t()
        msg.request_id, msg.skill, msg.start_utime = number, skill, when
        msg.phase_rate = trial.phase_rate
        msg.velocity = trial.velocity
        msg.duration_s = trial.duration_s if number == 1 else 0.0
        asked[when] = [msg]
    return asked


def _force(push: Push | None, time_s: float) -> tuple[float, float]:
    """Return the force on the torso during the tick that begins now, x and y [N]."""
    if push is None or not push.start_s <= time_s < push.start_s + PUSH_S - 1e-9:
        return 0.0, 0.0
    force = push.impulse_n_s / PUSH_S
    return force * math.cos(push.direction_rad), force * math.sin(push.direction_rad)
