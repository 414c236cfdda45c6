"""The stand and the gestures: no beat, their "beats" are seconds."""

from __future__ import annotations

from downbeat.policies.generator.choreography import (
    ArmKeys,
    Choreography,
    Keys,
    Offset,
    Wave,
)

SECOND_BPM = 60.0


def _cycles(channel: str, amplitude: float, seconds: float, count: int, lead: float = 0.0) -> Wave:
    """Return a wave with `count` periods in the gesture."""
    return Wave(channel, amplitude, seconds / count, lead)


STAND = Choreography(
    name="stand",
    title="Stand",
    beats=1,
    bpm=SECOND_BPM,
    has_beat=False,
    phrases=("stand still", "stop dancing", "stop", "freeze"),
)

TALK = Choreography(
    name="talk",
    title="Talk with the hands",
    beats=6,
    bpm=SECOND_BPM,
    has_beat=False,
    phrases=("talk", "explain", "tell me"),
    moves=(
        Offset("left_shoulder_pitch", -0.55),
        Offset("right_shoulder_pitch", -0.55),
        Offset("left_elbow", -0.7),
        Offset("right_elbow", -0.7),
        Offset("left_shoulder_yaw", 0.1),
        Offset("right_shoulder_yaw", -0.1),
        Offset("left_shoulder_roll", 0.1),
        Offset("right_shoulder_roll", -0.1),
        _cycles("left_shoulder_pitch", 0.15, 6.0, 3),
        _cycles("right_shoulder_pitch", 0.2, 6.0, 4, 1.0),
        _cycles("left_elbow", 0.35, 6.0, 4, 0.5),
        _cycles("right_elbow", 0.35, 6.0, 5, 2.0),
        _cycles("left_shoulder_yaw", 0.3, 6.0, 3, 1.0),
        _cycles("right_shoulder_yaw", 0.3, 6.0, 4, 0.3),
        _cycles("left_wrist_roll", 0.4, 6.0, 3, 2.0),
        _cycles("right_wrist_roll", -0.4, 6.0, 4),
        _cycles("waist_yaw", 0.12, 6.0, 1),
    ),
)

_UP = (-0.4, 1.75, 1.2, -0.35)

WAVE = Choreography(
    name="wave",
    title="Wave a hand",
    beats=5,
    bpm=SECOND_BPM,
    has_beat=False,
    loop=False,
    phrases=("wave", "say hello", "hello", "say goodbye"),
    arms=ArmKeys(
        keys=((0.0, "stand", "stand"), (1.0, "stand", _UP), (4.0, "stand", _UP)),
        move_beats=1.0,
    ),
    moves=(
        Keys("waist_yaw", ((0.0, 0.0), (1.0, -0.1), (4.0, -0.1)), 1.0),
        Keys("waist_roll", ((0.0, 0.0), (1.0, -0.05), (4.0, -0.05)), 1.0),
        Keys(
            "right_shoulder_yaw",
            (
                (1.0, 0.0),
                (1.4, 0.45),
                (1.8, -0.45),
                (2.2, 0.45),
                (2.6, -0.45),
                (3.0, 0.45),
                (3.4, -0.45),
                (3.8, 0.0),
            ),
            0.4,
        ),
    ),
)

GESTURES = {gesture.name: gesture for gesture in (STAND, TALK, WAVE)}
