"""The capture point, the polygon that the robot stands on, and where in it a point lies."""

from __future__ import annotations

import math
from collections.abc import Sequence

from downbeat.control.vectors import Vec3

Point = tuple[float, float]

GRAVITY_M_S2 = 9.81


def capture_point(com: Vec3, com_vel: Vec3) -> Point:
    """Return com + com_vel sqrt(height / g), x and y [m]: where a linear inverted pendulum stops.

    Args:
        com: (3,) [m] centre of mass, z above the floor.
        com_vel: (3,) [m/s].
    """
    time_constant_s = math.sqrt(max(com[2], 0.0) / GRAVITY_M_S2)
    return com[0] + time_constant_s * com_vel[0], com[1] + time_constant_s * com_vel[1]


def convex_hull(points: Sequence[Point]) -> list[Point]:
    """Return the corners of the convex hull, counter-clockwise (Andrew's monotone chain).

    Args:
        points: x, y [m]; one or two different points give a degenerate hull.
    """
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return ordered
    lower = _chain(ordered)
    ordered.reverse()
    upper = _chain(ordered)
    return lower[:-1] + upper[:-1]


def _chain(ordered: Sequence[Point]) -> list[Point]:
    """Return one side of the hull of points in order: every corner turns left."""
    chain: list[Point] = []
    for point in ordered:
        x, y = point
        while len(chain) > 1:
            ax, ay = chain[-2]
            bx, by = chain[-1]
            if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                break
            chain.pop()
        chain.append(point)
    return chain


def signed_distance(point: Point, hull: Sequence[Point]) -> float:
    """Return how far `point` is inside a convex hull [m]; negative outside, NaN without a hull.

    Args:
        point: x, y [m].
        hull: Corners as `convex_hull` returns them.
    """
    if not hull:
        return math.nan
    px, py = point
    inside = len(hull) > 2
    nearest_squared = math.inf
    ax, ay = hull[-1]
    for bx, by in hull:
        ex, ey, dx, dy = bx - ax, by - ay, px - ax, py - ay
        if ex * dy - ey * dx < 0.0:
            inside = False
        length_squared = ex * ex + ey * ey
        if length_squared > 0.0:
            share = (dx * ex + dy * ey) / length_squared
            share = 0.0 if share < 0.0 else (1.0 if share > 1.0 else share)
            dx -= share * ex
            dy -= share * ey
        squared = dx * dx + dy * dy
        if squared < nearest_squared:
            nearest_squared = squared
        ax, ay = bx, by
    distance = math.sqrt(nearest_squared)
    return distance if inside else -distance
