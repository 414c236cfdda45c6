"""What a sole tells: where its corners are, what carries, and how the robot moves if it rests."""

from __future__ import annotations

from dataclasses import dataclass

from downbeat.control.kinematics import SOLE_CORNERS, FootMotion
from downbeat.control.vectors import Rotation, Vec3, cross, minus, plus, turn


@dataclass(frozen=True, slots=True)
class SoleLimits:
    """When a sole is taken to rest.

    Attributes:
        corner_depth_m: Corners this much above the sole's lowest one carry nothing.
        rest_height_m: A sole this much above the lower one may rest.
        lift_height_m: A sole this much above the lower one does not.
        rest_speed_m_s: A sole that moves this fast may rest.
        slip_speed_m_s: A sole that moves this fast does not.
    """

    corner_depth_m: float = 0.01
    rest_height_m: float = 0.008
    lift_height_m: float = 0.025
    rest_speed_m_s: float = 0.25
    slip_speed_m_s: float = 0.6


@dataclass(frozen=True, slots=True)
class Sole:
    """A sole seen from the base, in axes of the world.

    Attributes:
        pos: (3,) [m] of its centre.
        corners: Four times (3,) [m].
        height: [m] of what carries; negative: below the base.
        imu_vel: (3,) [m/s] the velocity of the pelvis IMU if this sole rests.
    """

    pos: Vec3
    corners: tuple[Vec3, ...]
    height: float
    imu_vel: Vec3


def see_sole(
    limits: SoleLimits, motion: FootMotion, rotation: Rotation, turn_rate: Vec3, imu_arm: Vec3
) -> Sole:
    """Return a sole as the joints and the IMU show it.

    Args:
        limits: Only `corner_depth_m` matters.
        motion: The foot in the base frame.
        rotation: World <- base.
        turn_rate: (3,) [rad/s] of the base, world.
        imu_arm: (3,) [m] from the base to the pelvis IMU, world.
    """
    pos = turn(rotation, motion.pos)
    corners = _corners(motion, rotation, pos)
    carrier = _carrier(corners, limits.corner_depth_m)
    # v_imu = -(d/dt of the carrying point as seen from the IMU), in axes that do not turn.
    foot_turn = cross(turn(rotation, motion.ang_vel), minus(carrier, pos))
    seen = plus(turn(rotation, motion.lin_vel), foot_turn)
    base_turn = cross(turn_rate, minus(carrier, imu_arm))
    imu_vel = (-seen[0] - base_turn[0], -seen[1] - base_turn[1], -seen[2] - base_turn[2])
    return Sole(pos, corners, carrier[2], imu_vel)


def _corners(motion: FootMotion, rotation: Rotation, pos: Vec3) -> tuple[Vec3, ...]:
    px, py, pz = pos
    xx, xy, xz = turn(rotation, motion.x_axis)
    yx, yy, yz = turn(rotation, cross(motion.z_axis, motion.x_axis))
    return tuple(
        [
            (px + x * xx + y * yx, py + x * xy + y * yy, pz + x * xz + y * yz)
            for x, y, _ in SOLE_CORNERS
        ]
    )


def _carrier(corners: tuple[Vec3, ...], depth_m: float) -> Vec3:
    """Return the middle of the lowest corners; one that rises fades out, nothing jumps."""
    lowest = min([corner[2] for corner in corners])
    total = sum_x = sum_y = sum_z = 0.0
    for x, y, z in corners:
        weight = 1.0 - (z - lowest) / depth_m
        if weight > 0.0:
            total += weight
            sum_x += weight * x
            sum_y += weight * y
            sum_z += weight * z
    return sum_x / total, sum_y / total, sum_z / total


def rest_confidence(limits: SoleLimits, sole: Sole, floor: float, imu_vel: Vec3) -> float:
    """Return how surely a sole rests, 0..1: it is low, and it moves as the floor does.

    Args:
        limits: Of height and speed.
        sole: The sole.
        floor: [m] height of the lower sole's carrying corners, as `sole.height`.
        imu_vel: (3,) [m/s] what is known without this sole, world.
    """
    x, y, z = minus(sole.imu_vel, imu_vel)
    speed = (x * x + y * y + z * z) ** 0.5
    low = _fade(sole.height - floor, limits.rest_height_m, limits.lift_height_m)
    return low * _fade(speed, limits.rest_speed_m_s, limits.slip_speed_m_s)


def _fade(value: float, full: float, none: float) -> float:
    """Return 1 up to `full`, 0 from `none` on, a straight line between."""
    if value <= full:
        return 1.0
    return 0.0 if value >= none else (none - value) / (none - full)
