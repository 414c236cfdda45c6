"""What a reference and its gains must satisfy before they may become a skill."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from downbeat.catalog.mjcf import FLOOR
from downbeat.policies.errors import SkillRejected
from downbeat.policies.generator.feedback import Feedback
from downbeat.policies.generator.model import SIDES, BodyModel
from downbeat.policies.generator.reference import Reference

MAX_IK_ERROR = 1e-4
MAX_TORQUE_SHARE = 0.6
MIN_JOINT_SLACK_RAD = 0.04
MIN_FOOT_FORCE_N = 30.0
"""Of a foot that should carry at least half of the weight; a foot near 0 N tips."""
MIN_PLANTED_FORCE_N = 15.0
"""Of either foot of a planted dance."""
MAX_GAIN = 20.0


@dataclass(frozen=True, slots=True)
class Figures:
    """The numbers behind the checks.

    Attributes:
        ik_error: [m, rad]. torque_share: of the effort limit. joint_slack_rad: to the next limit.
        foot_force_n: smallest force under a foot that must carry weight. gain: largest |K|.
        joint_speed: largest [rad/s].
    """

    ik_error: float
    torque_share: float
    joint_slack_rad: float
    foot_force_n: float
    gain: float
    joint_speed: float


def check_reference(name: str, body: BodyModel, reference: Reference, planted: bool) -> None:
    """Refuse a reference that the robot cannot or must not follow.

    Raises:
        SkillRejected: Which limit, by how much, where in the loop.
    """
    for complaint in _complaints(body, reference, planted):
        raise SkillRejected(f"Skill '{name}' is rejected: {complaint}.")


def check_gain(name: str, feedback: Feedback) -> None:
    """Refuse gains that would amplify sensor noise.

    Raises:
        SkillRejected: With the largest gain and its tick.
    """
    largest = np.abs(feedback.gain).max(axis=(1, 2))  # (N,)
    tick = int(largest.argmax())
    if not largest[tick] <= MAX_GAIN:
        raise SkillRejected(
            f"Skill '{name}' is rejected: the feedback gain reaches {largest[tick]:.1f} at tick "
            f"{tick}, above {MAX_GAIN:g}."
        )


def figures(body: BodyModel, reference: Reference, feedback: Feedback, planted: bool) -> Figures:
    """Return the numbers that the checks look at."""
    return Figures(
        ik_error=reference.ik_error,
        torque_share=float(_torque_share(body, reference).max()),
        joint_slack_rad=float(_joint_slack(body, reference).min()),
        foot_force_n=float(_carried_force(reference, planted).min()),
        gain=float(np.abs(feedback.gain).max()),
        joint_speed=float(np.abs(reference.qvel[:, 6:]).max()),
    )


def _complaints(body: BodyModel, reference: Reference, planted: bool) -> Iterator[str]:
    tests: tuple[Callable[[], str | None], ...] = (
        lambda: _ik_complaint(reference),
        lambda: _slack_complaint(body, reference),
        lambda: self_contact(body, reference),
        lambda: _torque_complaint(body, reference),
        lambda: _force_complaint(reference, planted),
    )
    for test in tests:
        complaint = test()
        if complaint is not None:
            yield complaint


def _ik_complaint(reference: Reference) -> str | None:
    if reference.ik_error <= MAX_IK_ERROR:
        return None
    return f"the legs cannot reach the feet: error {reference.ik_error:.1e}, above {MAX_IK_ERROR:g}"


def _joint_slack(body: BodyModel, reference: Reference) -> np.ndarray:
    """Return the distance of every joint to its nearer limit, (N, 29) [rad]."""
    low, high = body.robot.joint_range.T
    joints = reference.qpos[:, 7:]
    return np.minimum(joints - low, high - joints)


def _slack_complaint(body: BodyModel, reference: Reference) -> str | None:
    slack = _joint_slack(body, reference)
    tick, joint = np.unravel_index(slack.argmin(), slack.shape)
    if slack[tick, joint] >= MIN_JOINT_SLACK_RAD:
        return None
    return (
        f"{body.robot.joint_names[joint]} comes within {slack[tick, joint]:.3f} rad of its limit "
        f"at tick {tick}; at least {MIN_JOINT_SLACK_RAD:g} rad must stay"
    )


def _torque_share(body: BodyModel, reference: Reference) -> np.ndarray:
    """Return every torque as a share of the motor's limit, (N, 29)."""
    return np.abs(reference.torque) / body.robot.effort_limit


def _torque_complaint(body: BodyModel, reference: Reference) -> str | None:
    share = _torque_share(body, reference)
    tick, joint = np.unravel_index(share.argmax(), share.shape)
    if share[tick, joint] <= MAX_TORQUE_SHARE:
        return None
    return (
        f"{body.robot.joint_names[joint]} needs {share[tick, joint]:.2f} of its torque at tick "
        f"{tick}; at most {MAX_TORQUE_SHARE:g} may be planned"
    )


def _carried_force(reference: Reference, planted: bool) -> np.ndarray:
    """Return the vertical force of every foot that must carry, (N, 2) [N]; inf elsewhere."""
    if planted:
        return reference.foot_force
    left = reference.left_weight[:, None]
    share = np.concatenate([left, 1.0 - left], axis=1)  # (N, 2)
    return np.where(share >= 0.5, reference.foot_force, np.inf)


def _force_complaint(reference: Reference, planted: bool) -> str | None:
    force = _carried_force(reference, planted)
    least = MIN_PLANTED_FORCE_N if planted else MIN_FOOT_FORCE_N
    tick, side = np.unravel_index(force.argmin(), force.shape)
    if force[tick, side] >= least:
        return None
    return (
        f"the {SIDES[side]} foot carries only {force[tick, side]:.0f} N at tick {tick}; "
        f"it needs {least:g} N to stay flat"
    )


def self_contact(body: BodyModel, reference: Reference) -> str | None:
    """Say which links touch each other and when; None if none do.

    Contact in the reference makes the linearisation useless (clapping hands: |K| 6700).
    """
    model, data = body.model, body.data
    floor = model.geom(FLOOR).id
    for tick, qpos in enumerate(reference.qpos):
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        for contact in data.contact[: data.ncon]:
            if floor not in (contact.geom1, contact.geom2):
                names = [model.body(model.geom_bodyid[g]).name for g in contact.geom]
                return f"{names[0]} touches {names[1]} at tick {tick}"
    return None
