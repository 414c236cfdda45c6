"""Where the robot dances: sky, floor, lights, cameras. Nothing here touches the physics."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

STAGE_RADIUS_M = 1.6
COLUMN_PREFIX = "column_"
NUM_COLUMNS = 19
COLUMN_HEIGHT_M = 1.5
COLUMN_RADIUS_M = 3.3
COLUMN_SPREAD_RAD = 2.2


def add_stage(
    root: ET.Element, world: ET.Element, floor: ET.Element, offscreen_size_px: tuple[int, int]
) -> None:
    """Add sky, floor material, lights and cameras.

    Args:
        root: The model.
        world: Its worldbody.
        floor: The floor's geom, which gets its material.
        offscreen_size_px: Largest picture, width and height.
    """
    _add_view(root, offscreen_size_px)
    assets = ET.SubElement(root, "asset")
    ET.SubElement(
        assets,
        "texture",
        name="sky",
        type="skybox",
        builtin="gradient",
        rgb1="0.20 0.15 0.33",
        rgb2="0.015 0.015 0.03",
        width="256",
        height="1536",
    )
    ET.SubElement(
        assets,
        "texture",
        name="floor",
        type="2d",
        builtin="checker",
        rgb1="0.115 0.12 0.15",
        rgb2="0.14 0.145 0.18",
        mark="edge",
        markrgb="0.20 0.21 0.26",
        width="256",
        height="256",
    )
    ET.SubElement(
        assets,
        "material",
        name="floor",
        texture="floor",
        texrepeat="2 2",
        texuniform="true",
        specular="0.3",
        shininess="0.3",
    )
    ET.SubElement(assets, "material", name="edge", rgba="0.10 0.75 0.90 1", emission="0.6")
    ET.SubElement(assets, "material", name="column", rgba="0.10 0.75 0.90 1", emission="0.5")
    ET.SubElement(
        assets,
        "material",
        name="stage",
        rgba="0.13 0.135 0.17 1",
        specular="0.4",
        shininess="0.5",
    )
    floor.set("material", "floor")
    _add_disc(world, "edge", STAGE_RADIUS_M, 0.0004)
    _add_disc(world, "stage", STAGE_RADIUS_M - 0.025, 0.0008)
    _add_columns(world)
    _add_lights(world)
    ET.SubElement(
        world,
        "camera",
        name="front",
        pos="3.0 -0.9 1.25",
        xyaxes="0.287 0.958 0 -0.137 0.041 0.990",
        fovy="38",
    )


def _add_view(root: ET.Element, offscreen_size_px: tuple[int, int]) -> None:
    visual = ET.SubElement(root, "visual")
    width, height = offscreen_size_px
    ET.SubElement(visual, "global", offwidth=str(width), offheight=str(height), fovy="38")
    ET.SubElement(visual, "quality", shadowsize="1024", offsamples="4", numslices="48")
    ET.SubElement(
        visual, "headlight", ambient="0.26 0.26 0.31", diffuse="0.10 0.10 0.11", specular="0 0 0"
    )
    ET.SubElement(visual, "map", znear="0.02", zfar="40", fogstart="6", fogend="14")
    ET.SubElement(visual, "rgba", fog="0.02 0.02 0.04 1", haze="0.10 0.08 0.17 1")
    statistic = ET.SubElement(root, "statistic")
    statistic.attrib.update(center="0 0 0.7", extent="1.6", meansize="0.08")


def _add_disc(world: ET.Element, material: str, radius: float, top: float) -> None:
    """Add a flat disc that only the eye meets; it ends a hair above the floor."""
    ET.SubElement(
        world,
        "geom",
        type="cylinder",
        size=f"{radius} {top}",
        material=material,
        group="1",
        contype="0",
        conaffinity="0",
    )


def _add_columns(world: ET.Element) -> None:
    """Add columns of light on an arc behind the stage; the video lets the music move them."""
    for k in range(NUM_COLUMNS):
        angle = math.pi + COLUMN_SPREAD_RAD * (k / (NUM_COLUMNS - 1) - 0.5)
        height = 0.35 + 0.25 * math.cos(3.0 * angle) ** 2
        x, y = COLUMN_RADIUS_M * math.cos(angle), COLUMN_RADIUS_M * math.sin(angle)
        ET.SubElement(
            world,
            "geom",
            name=f"{COLUMN_PREFIX}{k}",
            type="box",
            pos=f"{x:.4f} {y:.4f} {height / 2:.4f}",
            size=f"0.03 0.085 {height / 2:.4f}",
            euler=f"0 0 {angle:.4f}",
            material="column",
            group="1",
            contype="0",
            conaffinity="0",
        )


def _add_lights(world: ET.Element) -> None:
    """A warm key light that throws the shadow, and two coloured rims from behind."""
    spots = (
        ("key", "2.2 -1.6 3.4", "-0.50 0.36 -0.60", "0.74 0.71 0.66", "true", "50"),
        ("rim_left", "-2.2 2.4 2.2", "0.60 -0.66 -0.36", "0.18 0.36 0.62", "false", "55"),
        ("rim_right", "-2.0 -2.6 2.2", "0.55 0.70 -0.36", "0.58 0.18 0.46", "false", "55"),
    )
    for name, pos, direction, colour, shadow, cutoff in spots:
        ET.SubElement(
            world,
            "light",
            name=name,
            type="spot",
            pos=pos,
            dir=direction,
            diffuse=colour,
            specular="0.3 0.3 0.3",
            ambient="0 0 0",
            castshadow=shadow,
            cutoff=cutoff,
            exponent="6",
            attenuation="1 0 0",
        )
