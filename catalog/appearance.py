"""How the robot and its stage look. Nothing here touches the physics."""

from __future__ import annotations

import xml.etree.ElementTree as ET


def add_stage(
    root: ET.Element, world: ET.Element, floor: ET.Element, offscreen_size_px: tuple[int, int]
) -> None:
    """Add sky, floor material, lights and cameras."""
    visual = ET.SubElement(root, "visual")
    width, height = offscreen_size_px
    ET.SubElement(visual, "global", offwidth=str(width), offheight=str(height))


def add_appearance(root: ET.Element, bodies: dict[str, ET.Element], group: str) -> None:
    """Add the robot's shells to its bodies."""
