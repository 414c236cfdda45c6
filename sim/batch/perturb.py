"""What is different in every rollout: named profiles, and the robots drawn from them.

Robot number i of a seed is the same robot in every batch, cell and shard: draws come in blocks of
`BLOCK`, each from its own generator.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from downbeat.runtime.errors import one_of
from downbeat.sim.errors import SimError

F64 = NDArray[np.float64]

PROFILES = Path(__file__).parent.parent / "profiles"
BLOCK = 64
"""Robots per block: the unit of drawing, simulating and resuming."""
SUBSTEP_S = 0.005
Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Profile:
    """Ranges; see `sim/profiles/stage.toml` for what each is and why.

    Attributes:
        name: Of the profile.
        mass_scale: Factor on all masses and inertias.
        com_offset_m: Shift of the torso's centre of mass, each axis.
        gain_scale: Factor on stiffness and on damping, drawn separately.
        friction: Of soles and floor.
        command_s: From the measurement to the torque.
        noise: Half widths: orientation [rad], gyro [rad/s], joint position [rad], joint velocity
            [rad/s], base velocity [m/s].
        noise_scale: Factor on all of them, per rollout.
        impulse_n_s: Of one push on the torso.
        tempo_bpm: Of the music.
        same_tempo: Share of rollouts in which both skills dance to the same music.
        estimate: Half widths of the error of an estimated start: tilt [rad], joint position
            [rad], joint velocity [rad/s], base velocity [m/s], base rate [rad/s].
        fallen_below_m: Height of the pelvis that counts as fallen.
    """

    name: str
    mass_scale: Span
    com_offset_m: Span
    gain_scale: Span
    friction: Span
    command_s: Span
    noise: tuple[float, float, float, float, float]
    noise_scale: Span
    impulse_n_s: Span
    tempo_bpm: Span
    same_tempo: float
    estimate: tuple[float, float, float, float, float]
    fallen_below_m: float


NOISE_KEYS = ("orientation_rad", "gyro_rad_s", "joint_pos_rad", "joint_vel_rad_s")
_NOISE_KEYS = (*NOISE_KEYS, "base_lin_vel_m_s")
_ESTIMATE_KEYS = (
    "tilt_rad",
    "joint_pos_rad",
    "joint_vel_rad_s",
    "base_lin_vel_m_s",
    "base_ang_vel_rad_s",
)
_SPANS = {
    "mass_scale": ("robot", "mass_scale"),
    "com_offset_m": ("robot", "com_offset_m"),
    "gain_scale": ("robot", "gain_scale"),
    "friction": ("floor", "friction"),
    "command_s": ("delay", "command_s"),
    "noise_scale": ("noise", "scale"),
    "impulse_n_s": ("push", "impulse_n_s"),
    "tempo_bpm": ("music", "tempo_bpm"),
}


def profile_names() -> tuple[str, ...]:
    """Return the names of the bundled profiles."""
    return tuple(sorted(path.stem for path in PROFILES.glob("*.toml")))


@cache
def load_profile(name_or_path: str = "stage") -> Profile:
    """Load a bundled profile by name, or one's own by path.

    Raises:
        SimError: There is no such profile, or a value is missing or impossible.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = PROFILES / f"{name_or_path}.toml"
    if not path.is_file():
        raise SimError(
            f"There is no perturbation profile '{name_or_path}'; bundled ones are "
            f"{one_of(profile_names())}, or give the path of a .toml file."
        )
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SimError(f"{path} is not TOML: {error}.") from error
    spans = {field: _span(table, *key, path) for field, key in _SPANS.items()}
    return Profile(
        name=str(table.get("name", path.stem)),
        noise=tuple(_number(table, "noise", key, path) for key in _NOISE_KEYS),
        same_tempo=_number(table, "music", "same_tempo", path),
        estimate=tuple(_number(table, "estimate", key, path) for key in _ESTIMATE_KEYS),
        fallen_below_m=_number(table, "fall", "base_height_m", path),
        **spans,
    )


def _value(table: dict[str, Any], section: str, key: str, path: Path) -> Any:
    try:
        return table[section][key]
    except (KeyError, TypeError):
        raise SimError(f"{path}:{section}.{key} is missing.") from None


def _number(table: dict[str, Any], section: str, key: str, path: Path) -> float:
    value = _value(table, section, key, path)
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < 1e3:
        raise SimError(f"{path}:{section}.{key} is {value!r}; a number from 0 to 1000 is valid.")
    return float(value)


def _span(table: dict[str, Any], section: str, key: str, path: Path) -> Span:
    value = _value(table, section, key, path)
    numbers = isinstance(value, list) and len(value) == 2
    numbers = numbers and all(isinstance(v, int | float) and abs(v) < 1e3 for v in value)
    if not numbers or value[0] > value[1]:
        raise SimError(f"{path}:{section}.{key} is {value!r}; [low, high] is valid.")
    return float(value[0]), float(value[1])


@dataclass(frozen=True)
class Draws:
    """N robots and their nights; every array has N rows.

    Attributes:
        mass_scale: (N,).
        com_offset_m: (N, 3).
        friction: (N,).
        stiffness_scale: (N,).
        damping_scale: (N,).
        delay_substeps: (N,) int32, physics steps of 5 ms.
        noise: (N, 5) half widths in the order of `Profile.noise`.
        push_s: (N,) moment of the push after the change begins [s].
        push_n_s: (N, 2) impulse, world x and y.
        tempo_bpm: (N, 2) of the outgoing and of the incoming skill's music.
    """

    mass_scale: F64
    com_offset_m: F64
    friction: F64
    stiffness_scale: F64
    damping_scale: F64
    delay_substeps: NDArray[np.int32]
    noise: F64
    push_s: F64
    push_n_s: F64
    tempo_bpm: F64

    @property
    def count(self) -> int:
        """N."""
        return len(self.mass_scale)

    def take(self, ids: Any) -> Draws:
        """Return some of the robots."""
        return Draws(*(getattr(self, field.name)[ids] for field in fields(self)))


PUSH_WITHIN_S = 1.5
PUSH_S = 0.1
"""A push is a constant force for so long."""


@lru_cache(maxsize=512)
def draw_block(profile: Profile, seed: int, block: int) -> Draws:
    """Return the robots `block * BLOCK` ... of a seed."""
    rng = np.random.default_rng([seed, block, 0xD12A])
    n = BLOCK
    tempo = rng.uniform(*profile.tempo_bpm, (n, 2))
    same = rng.uniform(size=n) < profile.same_tempo
    tempo[same, 1] = tempo[same, 0]
    heading = rng.uniform(-np.pi, np.pi, n)
    impulse = rng.uniform(*profile.impulse_n_s, n)
    return Draws(
        mass_scale=rng.uniform(*profile.mass_scale, n),
        com_offset_m=rng.uniform(*profile.com_offset_m, (n, 3)),
        friction=rng.uniform(*profile.friction, n),
        stiffness_scale=rng.uniform(*profile.gain_scale, n),
        damping_scale=rng.uniform(*profile.gain_scale, n),
        delay_substeps=np.round(rng.uniform(*profile.command_s, n) / SUBSTEP_S).astype(np.int32),
        noise=rng.uniform(*profile.noise_scale, n)[:, None] * np.array(profile.noise),
        push_s=rng.uniform(0.0, PUSH_WITHIN_S, n),
        push_n_s=impulse[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1),
        tempo_bpm=tempo,
    )


def join_draws(parts: list[Draws]) -> Draws:
    """Return the robots of several draws, one after the other."""
    names = [field.name for field in fields(Draws)]
    return Draws(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))
