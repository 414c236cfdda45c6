"""Dances whose feet stay on the floor. All lengths in beats; amplitudes in m and rad."""

from __future__ import annotations

from math import pi

from downbeat.policies.generator.choreography import (
    ArmKeys,
    Choreography,
    Keys,
    Offset,
    Wave,
)

SWAY = Choreography(
    name="sway",
    title="Sway",
    beats=8,
    phrases=("sway", "sway gently"),
    arms=ArmKeys(
        keys=(
            (0.0, "open", "across"),
            (2.0, "across", "open"),
            (4.0, "open", "across"),
            (6.0, "across", "open"),
        ),
        move_beats=1.7,
    ),
    moves=(
        Wave("pelvis_y", 0.065, 4.0, pi / 2),
        Wave("pelvis_roll", 0.05, 4.0, pi / 2),
        Wave("waist_roll", -0.13, 4.0, pi / 2),
        Wave("waist_yaw", 0.28, 4.0, pi / 2),
        Wave("pelvis_z", -0.025, 1.0, shape="bounce"),
    ),
)

ARMWAVE = Choreography(
    name="armwave",
    title="Arm wave",
    beats=4,
    phrases=("arm wave", "do the wave"),
    arms=ArmKeys(keys=((0.0, (0.0, 1.35, -1.3, 1.1), (0.0, 1.35, -1.3, 1.1)),), move_beats=1.0),
    moves=(
        Wave("pelvis_z", -0.03, 1.0, shape="bounce"),
        Wave("pelvis_y", 0.035, 2.0),
        Wave("waist_yaw", 0.15, 4.0),
        Wave("left_shoulder_roll", 0.35, 2.0),
        Wave("right_shoulder_roll", 0.35, 2.0, -2.5),
        Wave("left_elbow", 0.5, 2.0, -0.8),
        Wave("right_elbow", 0.5, 2.0, -1.7),
        Wave("left_wrist_pitch", 0.5, 2.0, 0.9),
        Wave("right_wrist_pitch", 0.5, 2.0, -3.3),
        Wave("waist_roll", 0.12, 2.0),
    ),
)

TWIST = Choreography(
    name="twist",
    title="Twist",
    beats=4,
    phrases=("twist", "do the twist"),
    arms=ArmKeys(keys=((0.0, (-0.5, 0.45, 0.0, -0.1), (-0.5, 0.45, 0.0, -0.1)),), move_beats=1.0),
    moves=(
        Wave("waist_yaw", 0.6, 2.0),
        Wave("pelvis_yaw", -0.2, 2.0),
        Wave("pelvis_z", -0.035, 1.0, shape="bounce"),
        Wave("left_shoulder_pitch", 0.35, 2.0),
        Wave("right_shoulder_pitch", -0.35, 2.0),
    ),
)

PUMP = Choreography(
    name="pump",
    title="Pump",
    beats=4,
    phrases=("pump", "pump it", "raise the roof"),
    arms=ArmKeys(keys=((0.0, (-2.1, 0.5, 0.2, 0.8), (-2.1, 0.5, 0.2, 0.8)),), move_beats=1.0),
    moves=(
        Wave("pelvis_z", -0.07, 2.0, shape="bounce"),
        Wave("pelvis_pitch", 0.08, 2.0, shape="bounce"),
        Wave("left_shoulder_pitch", 1.2, 2.0, shape="bounce"),
        Wave("right_shoulder_pitch", 1.2, 2.0, shape="bounce"),
        Wave("left_elbow", -1.2, 2.0, shape="bounce"),
        Wave("right_elbow", -1.2, 2.0, shape="bounce"),
        Wave("left_shoulder_roll", 0.1, 2.0, shape="bounce"),
        Wave("right_shoulder_roll", -0.1, 2.0, shape="bounce"),
    ),
)

HIPCIRCLE = Choreography(
    name="hipcircle",
    title="Hip circles",
    beats=8,
    phrases=("hip circles", "circle your hips", "hula"),
    arms=ArmKeys(
        keys=(
            (0.0, "hip", "hip"),
            (2.0, "low", "low"),
            (4.0, "goal", "goal"),
            (6.0, "low", "low"),
        ),
        move_beats=2.0,
    ),
    moves=(
        Wave("pelvis_y", 0.055, 2.0),
        Wave("pelvis_x", 0.035, 2.0, pi / 2),
        Wave("pelvis_roll", 0.09, 2.0),
        Wave("pelvis_pitch", -0.10, 2.0, pi / 2),
        Wave("waist_roll", -0.16, 2.0),
        Wave("waist_pitch", 0.16, 2.0, pi / 2),
        Offset("pelvis_z", -0.02),
    ),
)

_DISCO_SIDES = ((0.0, 1.0), (2.0, -0.6), (4.0, -1.0), (6.0, 0.6))

DISCO = Choreography(
    name="disco",
    title="Disco point",
    beats=8,
    phrases=("disco", "disco point", "saturday night fever"),
    arms=ArmKeys(
        keys=(
            (0.0, "v", "hip"),
            (2.0, "chop_down", "hip"),
            (4.0, "hip", "v"),
            (6.0, "hip", "chop_down"),
        ),
        move_beats=1.2,
    ),
    moves=(
        Keys("waist_yaw", _DISCO_SIDES, 1.2, 0.3),
        Keys("waist_roll", _DISCO_SIDES, 1.2, -0.12),
        Keys("pelvis_y", _DISCO_SIDES, 1.4, -0.05),
        Wave("pelvis_z", -0.03, 1.0, shape="bounce"),
    ),
)

ROBOT = Choreography(
    name="robot",
    title="Robot",
    beats=8,
    phrases=("robot dance", "do the robot", "dance like a robot"),
    arms=ArmKeys(keys=((0.0, (-0.6, 0.5, 0.0, 0.1), (-0.6, 0.5, 0.0, 0.1)),), move_beats=1.0),
    moves=(
        Wave("waist_yaw", 0.38, 4.0, shape="square", hardness=1.7),
        Wave("left_elbow", -0.7, 4.0, pi / 2, "square", 2.0),
        Wave("right_elbow", 0.7, 4.0, pi / 2, "square", 2.0),
        Wave("left_shoulder_yaw", 0.5, 4.0, 0.0, "square", 2.0),
        Wave("right_shoulder_yaw", 0.5, 4.0, 0.0, "square", 2.0),
        Wave("waist_pitch", 0.06, 4.0, pi / 2, "square", 2.0),
        Wave("waist_roll", 0.05, 8.0, 0.0, "square", 1.6),
        Wave("pelvis_z", -0.015, 1.0, shape="bounce"),
    ),
)

KPOP = Choreography(
    name="kpop",
    title="K-pop",
    beats=16,
    phrases=("k pop", "kpop dance", "dab"),
    arms=ArmKeys(
        keys=(
            (0.0, "t", "hip"),
            (2.0, "v", "low"),
            (4.0, "hip", "t"),
            (6.0, "low", "v"),
            (8.0, "chest", "chest"),
            (10.0, "v", "v"),
            (12.0, "dab_out", "dab_in"),
            (14.0, "bent", "bent"),
        ),
        move_beats=1.3,
    ),
    moves=(
        Keys(
            "pelvis_y",
            ((0, 0.05), (2, 0.03), (4, -0.05), (6, -0.03), (8, 0), (10, 0), (12, 0.03), (14, 0)),
            1.6,
        ),
        Keys(
            "waist_roll",
            ((0, -0.12), (2, -0.072), (4, 0.12), (6, 0.072), (8, 0), (10, 0), (12, -0.07), (14, 0)),
            1.6,
        ),
        Keys(
            "waist_yaw",
            ((0, 0.3), (2, -0.2), (4, -0.3), (6, 0.2), (8, 0), (10, 0), (12, 0.3), (14, 0)),
            1.6,
        ),
        Keys("pelvis_z", ((0, 0), (6, 0), (8, -0.06), (10, 0), (12, -0.02), (14, -0.04)), 1.6),
        Wave("pelvis_z", -0.02, 1.0, shape="bounce"),
    ),
)

_THRILLER_SIDES = ((0.0, 1.0), (2.0, 1.0), (4.0, -1.0), (6.0, -1.0))

THRILLER = Choreography(
    name="thriller",
    title="Thriller",
    beats=8,
    phrases=("thriller", "monster dance"),
    arms=ArmKeys(
        keys=(
            (0.0, "claw_high", "claw"),
            (1.0, "claw", "claw"),
            (2.0, "claw_high", "claw_high"),
            (3.0, "claw", "claw"),
            (4.0, "claw", "claw_high"),
            (5.0, "claw", "claw"),
            (6.0, "claw_high", "claw_high"),
            (7.0, "claw", "claw"),
        ),
        move_beats=0.8,
    ),
    moves=(
        Keys("waist_yaw", _THRILLER_SIDES, 1.7, 0.38),
        Keys("waist_roll", _THRILLER_SIDES, 1.7, 0.16),
        Keys("pelvis_y", _THRILLER_SIDES, 1.7, 0.05),
        Offset("waist_pitch", 0.14),
        Offset("pelvis_pitch", 0.06),
        Offset("pelvis_z", -0.03),
        Wave("pelvis_z", -0.035, 1.0, shape="bounce"),
    ),
)

_TUTTING_SIDES = ((0.0, 1.0), (2.0, -1.0), (4.0, 0.0), (6.0, 0.0))

TUTTING = Choreography(
    name="tutting",
    title="Tutting",
    beats=8,
    phrases=("tutting", "dance like an egyptian"),
    arms=ArmKeys(
        keys=(
            (0.0, "goal", "goal_down"),
            (2.0, "goal_down", "goal"),
            (4.0, "goal", "goal"),
            (6.0, "goal_down", "goal_down"),
        ),
        move_beats=0.95,
    ),
    moves=(
        Keys("waist_roll", _TUTTING_SIDES, 0.95, 0.12),
        Keys("pelvis_y", _TUTTING_SIDES, 0.95, 0.045),
        Keys("pelvis_z", ((0.0, 0.0), (4.0, 0.0), (6.0, -0.08)), 0.95),
        Wave("pelvis_z", -0.025, 1.0, shape="bounce"),
    ),
)

WALTZ = Choreography(
    name="waltz",
    title="Waltz",
    beats=6,
    phrases=("waltz", "dance a waltz"),
    arms=ArmKeys(keys=((0.0, "frame", "hold"), (3.0, "hold", "frame")), move_beats=3.0),
    moves=(
        Wave("pelvis_y", 0.07, 6.0),
        Wave("waist_roll", -0.16, 6.0),
        Wave("waist_yaw", 0.55, 6.0, 0.5),
        Wave("pelvis_roll", 0.04, 6.0),
        Wave("pelvis_z", -0.03, 3.0, shape="bounce"),
    ),
)

SALSA = Choreography(
    name="salsa",
    title="Salsa",
    beats=8,
    phrases=("salsa", "latin dance"),
    arms=ArmKeys(
        keys=(
            (0.0, "bent_front", "bent_back"),
            (1.0, "bent", "bent"),
            (2.0, "bent_back", "bent_front"),
            (3.0, "bent", "bent"),
            (4.0, "bent_front", "overhead"),
            (6.0, "bent_back", "overhead"),
            (7.0, "bent", "bent"),
        ),
        move_beats=1.0,
    ),
    moves=(
        Wave("pelvis_y", 0.055, 2.0),
        Wave("pelvis_x", 0.02, 1.0),
        Wave("pelvis_roll", 0.12, 2.0, 0.3),
        Wave("pelvis_yaw", 0.16, 2.0, 1.2),
        Wave("waist_roll", -0.16, 2.0, 0.3),
        Wave("waist_yaw", -0.32, 2.0, 1.2),
        Offset("pelvis_z", -0.02),
        Wave("pelvis_z", -0.015, 1.0, shape="bounce"),
    ),
)

MONKEY = Choreography(
    name="monkey",
    title="Monkey",
    beats=4,
    phrases=("monkey", "do the monkey", "go go dance"),
    arms=ArmKeys(
        keys=(
            (0.0, "chop", "chop_down"),
            (1.0, "chop_down", "chop"),
            (2.0, "chop", "chop_down"),
            (3.0, "chop_down", "chop"),
        ),
        move_beats=1.0,
    ),
    moves=(
        Offset("pelvis_z", -0.02),
        Wave("pelvis_z", -0.05, 1.0, shape="bounce"),
        Offset("waist_pitch", 0.10),
        Wave("waist_pitch", 0.12, 1.0, pi / 2),
        Wave("waist_yaw", 0.2, 2.0, pi / 2),
    ),
)

PLANTED_DANCES = {
    dance.name: dance
    for dance in (
        SWAY,
        ARMWAVE,
        TWIST,
        PUMP,
        HIPCIRCLE,
        DISCO,
        ROBOT,
        KPOP,
        THRILLER,
        TUTTING,
        WALTZ,
        SALSA,
        MONKEY,
    )
}
