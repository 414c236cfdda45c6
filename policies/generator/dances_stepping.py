"""Dances with footwork: one step per beat, the swing foot lands on the beat.

They start and end in guard or low poses: a dance must not be entered with the arms overhead.
"""

from __future__ import annotations

from math import pi

from downbeat.policies.generator.choreography import (
    HOLD,
    ArmKeys,
    Choreography,
    Keys,
    Offset,
    Step,
    Wave,
)

STEPPING_HEIGHT_M = 0.745

DISCOSTEP = Choreography(
    name="discostep",
    title="Disco step",
    beats=8,
    height=STEPPING_HEIGHT_M,
    phrases=("disco step", "step to the disco"),
    steps=(
        Step("right", y=-0.08),
        Step("left"),
        Step("right"),
        HOLD,
        Step("left", y=0.08),
        Step("right"),
        Step("left"),
        HOLD,
    ),
    arms=ArmKeys(
        keys=(
            (0.0, "hip", "v"),
            (1.0, "hip", "v"),
            (2.0, "hip", "low"),
            (3.0, "bent", "bent"),
            (4.0, "v", "hip"),
            (5.0, "v", "hip"),
            (6.0, "low", "hip"),
            (7.0, "bent", "bent"),
        ),
        move_beats=0.95,
    ),
    moves=(
        Keys(
            "waist_yaw",
            ((0, -0.2), (1, -0.2), (2, 0.12), (3, 0), (4, 0.2), (5, 0.2), (6, -0.12), (7, 0)),
            1.0,
        ),
        Wave("waist_roll", 0.06, 8.0),
        Wave("pelvis_z", -0.015, 1.0, pi, "bounce"),
    ),
)

_ZOMBIE_SIDES = ((0.0, -1.0), (3.0, -1.0), (4.0, 1.0), (7.0, 1.0))

ZOMBIE = Choreography(
    name="zombie",
    title="Zombie",
    beats=8,
    height=STEPPING_HEIGHT_M,
    phrases=("zombie", "walk like a zombie"),
    steps=(
        Step("right", y=-0.09),
        Step("left", y=-0.09),
        Step("right", y=-0.09),
        HOLD,
        Step("left"),
        Step("right"),
        Step("left"),
        HOLD,
    ),
    arms=ArmKeys(
        keys=(
            (0.0, "claw_high", "claw"),
            (1.0, "claw", "claw"),
            (2.0, "claw_high", "claw_high"),
            (3.0, "claw_high", "claw_high"),
            (4.0, "claw", "claw_high"),
            (5.0, "claw", "claw"),
            (6.0, "claw_high", "claw_high"),
            (7.0, "claw_high", "claw_high"),
        ),
        move_beats=0.9,
    ),
    moves=(
        Keys("waist_yaw", _ZOMBIE_SIDES, 1.7, 0.3),
        Offset("waist_pitch", 0.12),
        Keys(
            "pelvis_z",
            ((0.0, 0.0), (2.4, 0.0), (3.1, -0.025), (4.0, 0.0), (6.4, 0.0), (7.1, -0.025)),
            0.9,
        ),
    ),
)

TURNSTEP = Choreography(
    name="turnstep",
    title="Turn step",
    beats=8,
    height=STEPPING_HEIGHT_M,
    phrases=("turn step", "turn from side to side"),
    steps=(
        Step("left", y=0.02, yaw=0.22),
        Step("right", yaw=0.22),
        Step("left", yaw=-0.22),
        Step("right", y=-0.02, yaw=-0.22),
        Step("left", y=0.02, yaw=0.22),
        Step("right", yaw=0.22),
        Step("left"),
        Step("right"),
    ),
    arms=ArmKeys(
        keys=(
            (0.0, "t", "chest"),
            (1.0, "bent", "bent"),
            (2.0, "chest", "t"),
            (3.0, "bent", "bent"),
            (4.0, "v", "v"),
            (5.0, "guard", "guard"),
            (6.0, "v", "v"),
            (7.0, "guard", "guard"),
        ),
        move_beats=0.95,
    ),
    moves=(
        Wave("pelvis_z", -0.015, 1.0, pi, "bounce"),
        Wave("waist_roll", 0.05, 4.0),
    ),
)

SALSASTEP = Choreography(
    name="salsastep",
    title="Salsa step",
    beats=8,
    height=STEPPING_HEIGHT_M,
    phrases=("salsa step", "dance salsa with steps"),
    steps=(
        Step("left", x=0.10),
        Step("right"),
        Step("left"),
        Step("right", x=-0.10),
        Step("left"),
        Step("right"),
        Step("left"),
        Step("right"),
    ),
    arms=ArmKeys(
        keys=(
            (0.0, "bent_back", "bent_front"),
            (1.0, "bent", "bent"),
            (2.0, "bent_front", "bent_back"),
            (3.0, "bent", "bent"),
            (4.0, "bent_front", "overhead"),
            (6.0, "bent_back", "overhead"),
            (7.0, "bent", "bent"),
        ),
        move_beats=1.0,
    ),
    moves=(
        Wave("waist_yaw", 0.24, 2.0),
        Wave("waist_roll", 0.07, 2.0),
        Wave("pelvis_z", -0.012, 1.0, pi, "bounce"),
    ),
)

BOXSTEP = Choreography(
    name="boxstep",
    title="Box step",
    beats=8,
    height=STEPPING_HEIGHT_M,
    phrases=("box step", "waltz with steps"),
    steps=(
        Step("left", x=0.10),
        Step("right", x=0.10, y=-0.06),
        Step("left", x=0.10, y=-0.06),
        Step("right", y=-0.06),
        Step("left"),
        Step("right"),
        Step("left"),
        Step("right"),
    ),
    arms=ArmKeys(keys=((0.0, "frame", "hold"), (4.0, "hold", "frame")), move_beats=4.0),
    moves=(
        Wave("waist_yaw", 0.25, 8.0),
        Wave("pelvis_z", -0.012, 2.0, shape="bounce"),
    ),
)

STEPPING_DANCES = {dance.name: dance for dance in (DISCOSTEP, ZOMBIE, TURNSTEP, SALSASTEP, BOXSTEP)}
