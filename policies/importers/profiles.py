"""Named built-in profiles: what recognised families do not write into their files.

Every value that is taken from here is printed and stands in the manifest's `inferred`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

ARM_STIFFNESS = (100, 100, 50, 50, 20, 20, 20)
ARM_DAMPING = (2, 2, 2, 2, 1, 1, 1)
LEGS = (
    "left_hip_pitch_joint",
    "left_hip_roll_joint",
    "left_hip_yaw_joint",
    "left_knee_joint",
    "left_ankle_pitch_joint",
    "left_ankle_roll_joint",
    "right_hip_pitch_joint",
    "right_hip_roll_joint",
    "right_hip_yaw_joint",
    "right_knee_joint",
    "right_ankle_pitch_joint",
    "right_ankle_roll_joint",
)
HELD_STIFFNESS = (*(100, 100, 100, 150, 40, 40) * 2, 300, 300, 300, *ARM_STIFFNESS * 2)
HELD_DAMPING = (*(2, 2, 2, 4, 2, 2) * 2, 9, 9, 9, *ARM_DAMPING * 2)
"""How joints are held that a network does not move, motor order.

Networks of fewer joints are trained on a body that is rigid there, and a soft or swinging waist
lets them fall. As unitree_rl_gym holds them on the robot, with three times its damping of the
waist: with that, walking with its network ends 0 of 6 times in a fall (6 of 6 without), and three
dances of 23 joints 0 of 9 times (3 of 3 with a waist of kp 28).
"""
KNEES_BENT = (
    *(-0.312, 0.0, 0.0, 0.669, -0.363, 0.0),
    *(-0.312, 0.0, 0.0, 0.669, -0.363, 0.0),
    *(0.0, 0.0, 0.0),
    *(0.2, 0.2, 0.0, 0.6, 0.0, 0.0, 0.0),
    *(0.2, -0.2, 0.0, 0.6, 0.0, 0.0, 0.0),
)
"""Default pose of holosoma and BeyondMimic, motor order [rad]."""


@dataclass(frozen=True)
class HolosomaProfile:
    """What holosoma keeps in its inference configuration, beside the ONNX file.

    Attributes:
        default_joint_pos: (29,) motor order [rad].
        action_scale: [rad].
        gait_period_s: [s]; None: no gait clock, it tracks a motion.
        terms: Of the observation; the network sees them in alphabetical order.
        scales: Factor of a term.
    """

    default_joint_pos: tuple[float, ...] = KNEES_BENT
    action_scale: float = 0.25
    gait_period_s: float | None = 1.0
    terms: tuple[str, ...] = (
        "actions",
        "base_ang_vel",
        "command_ang_vel",
        "command_lin_vel",
        "cos_phase",
        "dof_pos",
        "dof_vel",
        "projected_gravity",
        "sin_phase",
    )
    scales: Mapping[str, float] | None = None


@dataclass(frozen=True)
class RlGymProfile:
    """What unitree_rl_gym keeps in g1.yaml and in its deployment script."""

    joint_names: tuple[str, ...] = LEGS
    kps: tuple[float, ...] = (100, 100, 100, 150, 40, 40) * 2
    kds: tuple[float, ...] = (2, 2, 2, 4, 2, 2) * 2
    default_angles: tuple[float, ...] = (-0.1, 0.0, 0.0, 0.3, -0.2, 0.0) * 2
    ang_vel_scale: float = 0.25
    dof_pos_scale: float = 1.0
    dof_vel_scale: float = 0.05
    action_scale: float = 0.25
    cmd_scale: tuple[float, ...] = (2.0, 2.0, 0.25)
    gait_period_s: float = 0.8


@dataclass(frozen=True)
class AsapProfile:
    """What ASAP and its descendants keep in the configuration beside their 380-wide network.

    Attributes:
        default_joint_pos: (23,) [rad], legs, waist, four joints of each arm.
        joint_stiffness: (23,) [N m/rad].
        joint_damping: (23,) [N m s/rad].
    """

    default_joint_pos: tuple[float, ...]
    joint_stiffness: tuple[float, ...]
    joint_damping: tuple[float, ...]


@dataclass(frozen=True)
class MotionWindow:
    """Which part of a published motion file its author's state machine plays.

    Attributes:
        file: Name of the file.
        start_s, end_s: [s].
        rate_hz: Rows per second.
    """

    file: str
    start_s: float
    end_s: float
    rate_hz: float = 60.0


HOLOSOMA = {
    "holosoma_g1_29dof": HolosomaProfile(scales={"base_ang_vel": 0.25, "dof_vel": 0.05}),
    "holosoma_g1_wbt": HolosomaProfile(
        action_scale=1.0,
        gait_period_s=None,
        terms=(
            "actions",
            "base_ang_vel",
            "dof_pos",
            "dof_vel",
            "motion_command",
            "motion_ref_ori_b",
        ),
    ),
}
ASAP = {
    "asap_g1_23dof": AsapProfile(
        (*(-0.1, 0.0, 0.0, 0.3, -0.2, 0.0) * 2, *(0.0,) * 11),
        (*(100, 100, 100, 200, 20, 20) * 2, 400, 400, 400, *(90, 60, 20, 60) * 2),
        (*(2.5, 2.5, 2.5, 5.0, 0.2, 0.1) * 2, 5, 5, 5, *(2.0, 1.0, 0.4, 1.0) * 2),
    ),
    "pbhc_g1_23dof": AsapProfile(
        (
            *(-0.1, 0.0, 0.0, 0.3, -0.2, 0.0) * 2,
            *(0.0, 0.0, 0.0),
            *(0.2, 0.2, 0.0, 0.9, 0.2, -0.2, 0.0, 0.9),
        ),
        (*(100, 100, 100, 150, 40, 40) * 2, 400, 400, 400, *(100, 100, 50, 50) * 2),
        (*(2.0, 2.0, 2.0, 4.0, 2.0, 2.0) * 2, 5, 5, 5, *(2.0, 2.0, 2.0, 2.0) * 2),
    ),
}
ASAP_MOTIONS = {
    "cr7_level1": ("asap_g1_23dof", 3.967),
    "dance_0605": ("asap_g1_23dof", 18.0),
    "horse_squat": ("pbhc_g1_23dof", 6.67),
    "lift_up": ("asap_g1_23dof", 11.067),
    "apt_level1": ("asap_g1_23dof", 7.66),
    "kobe_level1": ("asap_g1_23dof", 4.16),
    "jump_forward_level1": ("asap_g1_23dof", 3.76),
    "jump_forward_level2": ("asap_g1_23dof", 3.56),
    "jump_forward_level3": ("asap_g1_23dof", 4.26),
    "kick_level1": ("asap_g1_23dof", 3.96),
    "kick_level2": ("asap_g1_23dof", 3.36),
    "kick_level3": ("asap_g1_23dof", 4.56),
    "lebron_level1": ("asap_g1_23dof", 5.067),
    "lebron_level2": ("asap_g1_23dof", 6.967),
    "side_jump_level1": ("asap_g1_23dof", 3.06),
    "side_jump_level2": ("asap_g1_23dof", 3.56),
    "side_jump_level3": ("asap_g1_23dof", 3.66),
}
"""Name of a published file or its folder -> profile, length of the motion [s]."""
RL_GYM = {"unitree_rl_gym_g1": RlGymProfile()}
WINDOWS = {
    "dance_102": MotionWindow("G1_Take_102.bvh_60hz.csv", 2.8, 24.0),
    "gangnam_style": MotionWindow("G1_gangnam_style_V01.bvh_60hz.csv", 5.2, 25.5),
    "my_dance": MotionWindow("my_dance_60hz.csv", 0.0, 10.0),
    "bata_dias": MotionWindow("bata_dias_full_60hz.csv", 0.0, 12.5),
    "dance_102_23dof": MotionWindow("dance_102_23dof_60hz.csv", 0.0, 20.0),
    "gangnam_style_23dof": MotionWindow("gangnam_style_23dof_60hz.csv", 0.0, 25.0),
    "bata_dias_23dof": MotionWindow("bata_dias_23dof_60hz.csv", 0.0, 12.5),
}
"""Chosen by the name of the motion file, or with --profile."""
VELOCITY_RANGES = ((-0.4, 0.6), (-0.3, 0.3), (-0.5, 0.5))
"""vx, vy [m/s], yaw rate [rad/s] for velocity policies that name none: careful."""
