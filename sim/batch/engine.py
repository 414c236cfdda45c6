"""What every batch engine takes and gives, the model they share, and how one is chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Any, Literal, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.mjcf import (
    FLOOR,
    FOOT_CAPSULE_PREFIXES,
    TORSO,
    ModelOptions,
    g1_mjcf,
)
from downbeat.catalog.robot import load_g1
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.batch.outcome import Outcome
from downbeat.sim.batch.perturb import SUBSTEP_S, Draws
from downbeat.sim.batch.script import Script
from downbeat.sim.errors import SimError

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]

SUBSTEPS = round(0.02 / SUBSTEP_S)
EngineName = Literal["auto", "native", "mjx", "warp"]
PELVIS = "pelvis"
SOLES = FOOT_CAPSULE_PREFIXES


@dataclass
class Start:
    """Where N rollouts begin.

    Attributes:
        qpos: (N, 36).
        qvel: (N, 35).
        warmstart: (N, 35) [m/s^2, rad/s^2] of the contact solver.
        target: (N, 29) [rad] what the motors were told in the tick before.
        memories: Skill name -> memory of a skill that plays already.
        steering: Skill name -> memory of its velocity command.
    """

    qpos: F64
    qvel: F64
    warmstart: F64
    target: F32
    memories: dict[str, dict[str, Any]] = field(default_factory=dict)
    steering: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """N."""
        return len(self.qpos)

    def take(self, ids: Any) -> Start:
        """Return some of the rollouts."""
        return Start(
            self.qpos[ids],
            self.qvel[ids],
            self.warmstart[ids],
            self.target[ids],
            {s: {k: v[ids] for k, v in m.items()} for s, m in self.memories.items()},
            {s: {k: v[ids] for k, v in m.items()} for s, m in self.steering.items()},
        )


def join_starts(parts: list[Start]) -> Start:
    """Return several starts of the same skills as one."""

    def trees(name: str) -> dict[str, dict[str, Any]]:
        first = getattr(parts[0], name)
        return {
            s: {k: np.concatenate([getattr(p, name)[s][k] for p in parts]) for k in first[s]}
            for s in first
        }

    arrays = [np.concatenate([getattr(p, n) for p in parts]) for n in _START_ARRAYS]
    return Start(*arrays, trees("memories"), trees("steering"))


_START_ARRAYS = ("qpos", "qvel", "warmstart", "target")

Watch = Callable[[int, NDArray[np.int64], Callable[[], Start]], None]
"""Called at the begin of every tick with the tick, who still stands, and how to get their state."""


class Engine(Protocol):
    """Runs scripts."""

    name: str
    manifests: dict[str, SkillManifest]

    def run(
        self,
        start: Start,
        script: Script,
        draws: Draws,
        seed: tuple[int, ...],
        watch: Watch | None = None,
        last_tick: int | None = None,
        settle_tick: int | None = None,
    ) -> Outcome:
        """Simulate N rollouts.

        Args:
            start: Where they begin.
            script: What plays.
            draws: What is different in each.
            seed: Of the sensor noise.
            watch: Sees every tick.
            last_tick: Stop before this tick; None: play the whole script.
            settle_tick: From here on robots that have calmed down need not be simulated further.
        """
        ...


@cache
def batch_model(only_soles: bool = False) -> Any:
    """Return the model of all batch engines: the generator's physics at 5 ms, no looks.

    Sensors: centre of mass (3) [m] and its velocity (3) [m/s], world.

    Args:
        only_soles: Nothing but the soles touches anything: MJX computes every contact that could
            ever be, 366 of them with the whole body (8 with the soles), and a robot counts as
            fallen before the rest of it touches the floor.
    """
    options = ModelOptions(timestep_s=SUBSTEP_S, visual=False, self_collision=not only_soles)
    spec = mujoco.MjSpec.from_string(g1_mjcf(options))
    if only_soles:
        for geom in spec.geoms:
            if geom.name != FLOOR and not geom.name.startswith(SOLES):
                geom.contype = geom.conaffinity = 0
    for kind in (mujoco.mjtSensor.mjSENS_SUBTREECOM, mujoco.mjtSensor.mjSENS_SUBTREELINVEL):
        spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_BODY, objname=PELVIS)
    return spec.compile()


@dataclass(frozen=True)
class ModelIds:
    """Indices into the model that both engines use."""

    torso: int
    feet: tuple[int, int]
    floor_and_soles: NDArray[np.int64]
    torque_limit: F64


@cache
def model_ids() -> ModelIds:
    """Return the ids of `batch_model`."""
    model = batch_model()
    feet = tuple(model.body(name).id for name in load_g1().feet.body_names)
    names = [model.geom(index).name for index in range(model.ngeom)]
    rubbing = [i for i, name in enumerate(names) if name == FLOOR or name.startswith(SOLES)]
    limit = np.asarray(model.actuator_forcerange[:, 1], float)
    return ModelIds(model.body(TORSO).id, feet, np.array(rubbing), limit)


def tilt_limit(manifests: Mapping[str, SkillManifest] | list[SkillManifest]) -> float:
    """Return the tilt beyond which safety would have tripped [rad]."""
    items = manifests.values() if isinstance(manifests, Mapping) else manifests
    return max(manifest.limits.tilt_rad for manifest in items)


def check_versions() -> None:
    """Refuse mujoco and mujoco-mjx of different minor versions: silently wrong (measured).

    Raises:
        SimError: They differ, or mujoco-mjx is not installed.
    """
    try:
        ours, theirs = version("mujoco"), version("mujoco-mjx")
    except PackageNotFoundError as error:
        raise SimError(
            "The MJX engine needs mujoco-mjx and jax; install them with "
            f"pip install 'downbeat[mjx]' ({error})."
        ) from error
    if ours.split(".")[:2] != theirs.split(".")[:2]:
        wanted = ".".join(ours.split(".")[:2])
        raise SimError(
            f"mujoco {ours} and mujoco-mjx {theirs} differ in their minor version, which makes "
            f"saturated motors wrong without a word; install mujoco-mjx=={wanted}.*"
        )


def open_engine(
    name: EngineName, manifests: Mapping[str, SkillManifest], threads: int = 0
) -> Engine:
    """Open an engine for some skills.

    Args:
        name: "auto" takes MJX on a GPU where there is one, else the native engine.
        manifests: Skill name -> manifest; whatever scripts will play.
        threads: Of the native engine; 0: one per core.

    Raises:
        SimError: It cannot run here.
    """
    name = resolve_engine(name)
    if name == "native":
        from downbeat.sim.batch.native import NativeEngine

        return NativeEngine(manifests, threads)
    check_versions()
    from downbeat.sim.batch.mjx import MjxEngine

    return MjxEngine(manifests, impl="warp" if name == "warp" else "jax")


def resolve_engine(name: EngineName) -> EngineName:
    """Return the engine that "auto" means here; any other name means itself."""
    if name != "auto":
        return name
    return "mjx" if _has_gpu() else "native"


def _has_gpu() -> bool:
    if find_spec("jax") is None or find_spec("mujoco.mjx") is None:
        return False
    from downbeat.sim.batch.xla import calm_xla

    calm_xla()
    import jax

    try:
        return jax.default_backend() == "gpu"
    except RuntimeError:
        return False
