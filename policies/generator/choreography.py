"""A dance as data: waves, keyframes on beats, arm poses and feet per beat; and how it is sampled.

Time is counted in beats. Everything is periodic over the loop, so a dance closes by construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.robot import load_g1
from downbeat.policies.errors import PolicyError
from downbeat.policies.generator.arms import Pose, left_arm, right_arm
from downbeat.runtime.errors import one_of

F64 = NDArray[np.float64]
NUM_LEG_JOINTS = 12
LEFT_ARM = slice(3, 10)
"""Columns of the left arm among the 17 upper joints (waist 3, left arm 7, right arm 7)."""
RIGHT_ARM = slice(10, 17)
PELVIS_CHANNELS = (
    "pelvis_x",
    "pelvis_y",
    "pelvis_z",
    "pelvis_roll",
    "pelvis_pitch",
    "pelvis_yaw",
)
UPPER_CHANNELS = tuple(
    name.removesuffix("_joint") for name in load_g1().joint_names[NUM_LEG_JOINTS:]
)
CHANNELS = PELVIS_CHANNELS + UPPER_CHANNELS

Shape = Literal["sine", "square", "bounce"]
Foot = Literal["left", "right"]


@dataclass(frozen=True, slots=True)
class Wave:
    """A periodic motion of one channel.

    Attributes:
        channel: One of CHANNELS.
        amplitude: [m] or [rad].
        period_beats: Length of one period [beats].
        lead_rad: Phase at beat 0 [rad].
        shape: "sine"; "square": a sine squashed by tanh (quick, then held); "bounce": 0 on the
            beat, `amplitude` half a period later.
        hardness: Of the squashing.
    """

    channel: str
    amplitude: float
    period_beats: float
    lead_rad: float = 0.0
    shape: Shape = "sine"
    hardness: float = 1.6

    def at(self, beat: F64) -> F64:
        """Return the value at each beat time, (N,)."""
        angle = 2.0 * np.pi * beat / self.period_beats + self.lead_rad  # (N,)
        if self.shape == "bounce":
            return self.amplitude * (1.0 - np.cos(angle)) / 2.0
        if self.shape == "square":
            return self.amplitude * np.tanh(self.hardness * np.sin(angle)) / np.tanh(self.hardness)
        return self.amplitude * np.sin(angle)


@dataclass(frozen=True, slots=True)
class Keys:
    """Keyframes of one channel: each value is reached on its beat and held until the next move.

    Attributes:
        channel: One of CHANNELS.
        keys: (beat, value) pairs, value in [m] or [rad].
        move_beats: A move starts this long before its beat [beats].
        scale: Factor on all values.
    """

    channel: str
    keys: tuple[tuple[float, float], ...]
    move_beats: float
    scale: float = 1.0


@dataclass(frozen=True, slots=True)
class ArmKeys:
    """Arm poses on beats.

    Attributes:
        keys: (beat, pose of the left arm, pose of the right arm).
        move_beats: A move starts this long before its beat [beats].
    """

    keys: tuple[tuple[float, Pose, Pose], ...]
    move_beats: float


@dataclass(frozen=True, slots=True)
class Offset:
    """A constant shift of one channel, [m] or [rad]."""

    channel: str
    value: float


@dataclass(frozen=True, slots=True)
class Step:
    """What the feet do during one beat; the swing foot lands at the end of it.

    Attributes:
        foot: The foot that swings; None: both stay.
        x, y: Where it lands, relative to its own place in the stand [m].
        yaw: Turn of the foot there [rad].
    """

    foot: Foot | None = None
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0


HOLD = Step()


@dataclass(frozen=True, slots=True)
class Choreography:
    """A loop of movement.

    Attributes:
        name: Skill name.
        title: For people.
        beats: Length of the loop [beats].
        bpm: Tempo it is built at.
        moves: Waves, keyframes and offsets; they add up.
        arms: Arm poses; None leaves the arms to `moves` around the stand pose.
        steps: One per beat; empty: both feet stay.
        height: Of the pelvis above the floor [m].
        has_beat: False for gestures: their "beats" are plain seconds at bpm 60.
        loop: False: a gesture that ends after one pass.
        phrases: What a person may say to ask for it.
    """

    name: str
    title: str
    beats: int
    bpm: float = 120.0
    moves: tuple[Wave | Keys | Offset, ...] = ()
    arms: ArmKeys | None = None
    steps: tuple[Step, ...] = ()
    height: float = 0.755
    has_beat: bool = True
    loop: bool = True
    phrases: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse channels that do not exist and footwork that does not fill the loop.

        Raises:
            PolicyError: Naming the dance and what would be valid.
        """
        for move in self.moves:
            if move.channel not in CHANNELS:
                raise PolicyError(
                    f"Channel '{move.channel}' of dance '{self.name}' is unknown; "
                    f"channels are {one_of(CHANNELS)}."
                )
        if self.steps and len(self.steps) != self.beats:
            raise PolicyError(
                f"Dance '{self.name}' has {len(self.steps)} steps for {self.beats} beats; "
                f"it needs one per beat (HOLD keeps both feet)."
            )


@dataclass(frozen=True, slots=True)
class BodyMotion:
    """A sampled choreography without its feet.

    Attributes:
        pelvis_pos: (N, 3) [m] relative to the middle of the feet.
        pelvis_rpy: (N, 3) [rad].
        upper_joint_pos: (N, 17) [rad] waist and arms.
    """

    pelvis_pos: F64
    pelvis_rpy: F64
    upper_joint_pos: F64


def minimum_jerk(x: F64) -> F64:
    """Return 10x^3 - 15x^4 + 6x^5, from 0 to 1 with no speed and no acceleration at both ends."""
    x = np.clip(x, 0.0, 1.0)
    return x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def sample_keys(
    beat: F64, loop_beats: float, keys: Sequence[tuple[float, F64]], move_beats: float
) -> F64:
    """Return keyframed values (N, D) at beat times (N,), periodic over `loop_beats`.

    Args:
        beat: (N,) in [0, loop_beats).
        loop_beats: Length of the loop.
        keys: (beat, value (D,)), any order.
        move_beats: Longest time of a move; shorter when keys lie closer together.
    """
    ordered = sorted(keys, key=lambda key: key[0])
    times = np.array([key[0] for key in ordered])  # (K,)
    values = np.stack([np.atleast_1d(key[1]) for key in ordered]).astype(float)  # (K, D)
    last = (np.searchsorted(times, beat, side="right") - 1) % len(times)  # (N,)
    following = (last + 1) % len(times)
    since = (beat - times[last]) % loop_beats  # (N,) beats since the last key
    gap = (times[following] - times[last]) % loop_beats
    gap = np.where(gap == 0.0, loop_beats, gap)
    move = np.minimum(move_beats, gap)
    share = minimum_jerk((since - (gap - move)) / move)[:, None]  # (N, 1)
    return values[last] + (values[following] - values[last]) * share


def sample(dance: Choreography, beat: F64, amplitude: float = 1.0) -> BodyMotion:
    """Return the body's motion at beat times (N,).

    Args:
        dance: What to sample.
        beat: (N,) in [0, dance.beats).
        amplitude: Factor on waves and keyframes; arm poses keep their shape.
    """
    joints = load_g1().default_joint_pos[NUM_LEG_JOINTS:]
    upper = np.tile(joints, (len(beat), 1))  # (N, 17)
    if dance.arms is not None:
        for columns, side, arm in ((LEFT_ARM, 1, left_arm), (RIGHT_ARM, 2, right_arm)):
            keys = [(key[0], arm(key[side])) for key in dance.arms.keys]
            upper[:, columns] = sample_keys(beat, dance.beats, keys, dance.arms.move_beats)
    shift = np.zeros((len(beat), len(CHANNELS)))  # (N, 23)
    for move in dance.moves:
        shift[:, CHANNELS.index(move.channel)] += _sample_move(move, beat, dance.beats, amplitude)
    pelvis_pos = shift[:, :3]
    pelvis_pos[:, 2] += dance.height
    return BodyMotion(pelvis_pos, shift[:, 3:6], upper + shift[:, 6:])


def _sample_move(move: Wave | Keys | Offset, beat: F64, loop_beats: int, amplitude: float) -> F64:
    if isinstance(move, Offset):
        return np.full(len(beat), move.value)
    if isinstance(move, Wave):
        return amplitude * move.at(beat)
    keys = [(time, np.array([value])) for time, value in move.keys]
    return amplitude * move.scale * sample_keys(beat, loop_beats, keys, move.move_beats)[:, 0]
