"""Colours that the timeline and the video share."""

from __future__ import annotations

from collections.abc import Iterable

BACKGROUND = "#11131b"
PANEL = "#1a1d29"
INK = "#f2f3f7"
MUTED = "#8d93a6"
GOOD = "#4ade80"
WARNING = "#fbbf24"
BAD = "#ff4d5e"
CUT = "#ffb454"

STANDING = ("stand", "")
STAND_COLOUR = "#5b6072"
SKILL_COLOURS = (
    "#4cc9f0",
    "#f72585",
    "#ffd166",
    "#7ae582",
    "#b388ff",
    "#ff8c42",
    "#2ec4b6",
    "#ff99c8",
    "#90be6d",
    "#5c7cfa",
    "#e5989b",
    "#c0ca33",
)


def skill_colours(skills: Iterable[str]) -> dict[str, str]:
    """Return a colour per skill, in the order of first appearance; standing is grey."""
    colours: dict[str, str] = {}
    for skill in skills:
        if skill in STANDING:
            colours[skill] = STAND_COLOUR
        elif skill not in colours:
            used = sum(1 for name in colours if name not in STANDING)
            colours[skill] = SKILL_COLOURS[used % len(SKILL_COLOURS)]
    return colours


def rgb(colour: str) -> tuple[int, int, int]:
    """Return "#rrggbb" as three numbers 0..255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
