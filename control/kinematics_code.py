"""Write the robot's forward kinematics as straight-line Python from catalog/g1_facts.json.

Quantities of a limb are carried from its tip to the base, joint by joint:

    p_parent = Q R(q) p_body + pos,    dp_parent = Q R(q) (dp_body + dq axis x p_body)

with the constant rotation Q and offset `pos` of the body and the joint's angle q. A joint turns
about one axis, so it costs four products per vector; factors 0 and 1 are never written.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from downbeat.catalog.robot import load_g1
from downbeat.control.kinematics_links import (
    IDENTITY,
    Link,
    Numbers,
    conjugate,
    matrix,
    rotated,
)

Term = float | str
"""A number known while the code is written, or the name of a variable in it."""
Vector = tuple[Term, Term, Term]


class Writer:
    """Lines of a function body; sums of products are simplified before they are written."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._count = 0
        self._trig: dict[str, tuple[str, str]] = {}

    def total(self, *products: Sequence[Term]) -> Term:
        """Write the sum of `products` and return its variable, or its value if it is a number."""
        constant = 0.0
        parts: list[str] = []
        for product in products:
            factor = math.prod(t for t in product if not isinstance(t, str))
            names = [t for t in product if isinstance(t, str)]
            if not names:
                constant += factor
            elif factor != 0.0:
                parts.append(_signed(factor, names, bool(parts)))
        if not parts:
            return constant
        if constant != 0.0:
            parts.append(_signed(constant, [], True))
        text = "".join(parts)
        return text if text.isidentifier() else self.assign(text)

    def assign(self, expression: str) -> str:
        """Write `name = expression` and return the name."""
        self._count += 1
        name = f"t{self._count}"
        self.lines.append(f"{name} = {expression}")
        return name

    def cos_sin(self, angle: str) -> tuple[str, str]:
        """Return the variables with the cosine and the sine of an angle; written once per angle."""
        if angle not in self._trig:
            self._trig[angle] = (self.assign(f"cos({angle})"), self.assign(f"sin({angle})"))
        return self._trig[angle]

    def function(self, name: str, arguments: str, result: str) -> str:
        """Return the source of a function with these lines."""
        body = "".join(f"    {line}\n" for line in [*self.lines, f"return {result}"])
        return f"def {name}({arguments}):\n{body}"


def _signed(factor: float, names: list[str], follows: bool) -> str:
    """Return one summand with its sign, as it is written after others or first."""
    sign = (" - " if factor < 0.0 else " + ") if follows else ("-" if factor < 0.0 else "")
    size = abs(factor)
    return sign + " * ".join(([repr(size)] if size != 1.0 or not names else []) + names)


# ---------------------------------------------------------------------- what is written


def turn(w: Writer, link: Link, vector: Vector) -> Vector:
    """Write Q R(q) `vector`."""
    i, j, k = link.axis, (link.axis + 1) % 3, (link.axis + 2) % 3
    turned: list[Term] = list(vector)
    if link.joint >= 0 and (vector[j] != 0.0 or vector[k] != 0.0):
        cos, sin = w.cos_sin(link.angle)
        turned[i] = vector[i]
        turned[j] = w.total((cos, vector[j]), (-1.0, sin, vector[k]))
        turned[k] = w.total((sin, vector[j]), (cos, vector[k]))
    if link.quat == IDENTITY:
        return turned[0], turned[1], turned[2]
    rows = matrix(link.quat)
    x, y, z = (w.total(*zip(row, turned)) for row in rows)
    return x, y, z


def spin(w: Writer, link: Link, vector: Vector, rate: Vector) -> Vector:
    """Write `rate` + dq axis x `vector`."""
    j, k = (link.axis + 1) % 3, (link.axis + 2) % 3
    out: list[Term] = list(rate)
    out[j] = w.total((out[j],), (-1.0, f"v{link.joint}", vector[k]))
    out[k] = w.total((out[k],), (f"v{link.joint}", vector[j]))
    return out[0], out[1], out[2]


def add(w: Writer, *vectors: Vector) -> Vector:
    """Write a sum of vectors."""
    x, y, z = (w.total(*((v[i],) for v in vectors)) for i in range(3))
    return x, y, z


def foot_code(w: Writer, links: Sequence[Link], tip: int, point: Sequence[float]) -> list[Vector]:
    """Write a foot seen from the base: position, velocity, rate of turn, x axis, z axis."""
    inverse = conjugate(links[tip].own)
    pos: Vector = rotated(inverse, point)
    vel: Vector = (0.0, 0.0, 0.0)
    rate: Vector = (0.0, 0.0, 0.0)
    axes: list[Vector] = [rotated(inverse, (1.0, 0.0, 0.0)), rotated(inverse, (0.0, 0.0, 1.0))]
    while links[tip].parent >= 0:
        link = links[tip]
        vel = turn(w, link, spin(w, link, pos, vel))
        own_rate = [0.0 if i != link.axis else f"v{link.joint}" for i in range(3)]
        rate = turn(w, link, add(w, rate, (own_rate[0], own_rate[1], own_rate[2])))
        pos = add(w, turn(w, link, pos), link.pos)
        axes = [turn(w, link, axis) for axis in axes]
        tip = link.parent
    return [pos, vel, rate, *axes]


def com_code(w: Writer, links: Sequence[Link], with_velocity: bool) -> list[Vector]:
    """Write the centre of mass seen from the base and, if wanted, its velocity."""
    total = sum(link.mass for link in links)
    share = [link.mass / total for link in links]  # of the body and everything beyond it
    moment: list[Vector] = [
        (m * link.com[0], m * link.com[1], m * link.com[2]) for m, link in zip(share, links)
    ]
    rate: list[Vector] = [(0.0, 0.0, 0.0)] * len(links)
    for i in range(len(links) - 1, 0, -1):
        link, parent = links[i], links[i].parent
        if with_velocity:
            carried = turn(w, link, spin(w, link, moment[i], rate[i]))
            rate[parent] = add(w, rate[parent], carried)
        m, pos = share[i], link.pos
        lever = (m * pos[0], m * pos[1], m * pos[2])
        moment[parent] = add(w, moment[parent], turn(w, link, moment[i]), lever)
        share[parent] += m
    return [moment[0], rate[0]] if with_velocity else [moment[0]]


def pose_code(w: Writer, links: Sequence[Link], tip: int) -> tuple[Vector, list[Term]]:
    """Write a body's pose seen from the base: position and quaternion wxyz."""
    quat: list[Term] = list(conjugate(links[tip].own))
    pos: Vector = (0.0, 0.0, 0.0)
    while links[tip].parent >= 0:
        link = links[tip]
        pos = add(w, turn(w, link, pos), link.pos)
        cos, sin = w.cos_sin(f"0.5 * ({link.angle})")
        joint: list[Term] = [cos, 0.0, 0.0, 0.0]
        joint[1 + link.axis] = sin
        quat = _product(w, link.quat, _product(w, joint, quat))
        tip = link.parent
    return pos, quat


def _product(w: Writer, a: Sequence[Term], b: Sequence[Term]) -> list[Term]:
    """Write the quaternion product a b."""
    return [
        w.total((a[0], b[0]), (-1.0, a[1], b[1]), (-1.0, a[2], b[2]), (-1.0, a[3], b[3])),
        w.total((a[0], b[1]), (a[1], b[0]), (a[2], b[3]), (-1.0, a[3], b[2])),
        w.total((a[0], b[2]), (-1.0, a[1], b[3]), (a[2], b[0]), (a[3], b[1])),
        w.total((a[0], b[3]), (a[1], b[2]), (-1.0, a[2], b[1]), (a[3], b[0])),
    ]


def tuple_of(terms: Iterable[Term]) -> str:
    """Return the text of a tuple."""
    return f"({', '.join(t if isinstance(t, str) else repr(t) for t in terms)})"


def sole_centre() -> Numbers:
    """Return the middle of the sole's contact points in the foot's frame [m]."""
    feet = load_g1().feet
    count = len(feet.pos)
    return sum(p[0] for p in feet.pos) / count, sum(p[1] for p in feet.pos) / count, feet.sole_z
