"""The picture of a moment: robot, stage and camera. Import it only with MUJOCO_GL settled."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from downbeat.catalog.mjcf import ModelOptions, g1_mjcf
from downbeat.catalog.stage import COLUMN_HEIGHT_M, COLUMN_PREFIX, NUM_COLUMNS

F64 = NDArray[np.float64]

FOLLOW_S = 1.2
"""The camera follows the mean of the robot's place over about this long, before and after."""
LOOK_HEIGHT_M = 0.61
DISTANCE_M = 2.75
AZIMUTH_DEG, ORBIT_DEG, ORBIT_PERIOD_S = 162.0, 16.0, 26.0
ELEVATION_DEG = -8.0
GLOWING = {"edge": 1.0, "accent": 1.0, "column": 0.55}
"""Materials in the colour of the dance, and how much of it; the columns stay in the background."""
FEET = ("left_ankle_roll_link", "right_ankle_roll_link")


@dataclass(frozen=True)
class Quality:
    """How finely a frame is rendered before it is scaled to the video's size."""

    name: str
    size_px: tuple[int, int]
    samples: int
    has_shadows: bool
    has_reflections: bool


QUALITIES = (
    Quality("fine", (1920, 1080), 4, True, True),
    Quality("good", (1280, 720), 0, True, False),
    Quality("fast", (1280, 720), 0, False, False),
    Quality("plain", (960, 540), 0, False, False),
)
"""From the best down; without a GPU it is one of the last two: soft discs stand for shadows."""


class Scene:
    """Renders the robot at given states."""

    def __init__(self, quality: Quality) -> None:
        """Build the model and open a GL context.

        Raises:
            Exception: There is no GL; what is raised depends on the platform.
        """
        self.quality = quality
        text = g1_mjcf(ModelOptions(offscreen_size_px=quality.size_px))
        self._model: Any = mujoco.MjModel.from_xml_string(text)
        self._model.vis.quality.offsamples = quality.samples
        if quality.has_reflections:
            for name in ("floor", "stage"):
                self._model.mat_reflectance[self._model.material(name).id] = 0.15
        self._data: Any = mujoco.MjData(self._model)
        width, height = quality.size_px
        self._renderer = mujoco.Renderer(self._model, height, width)
        self._camera = mujoco.MjvCamera()
        self._option = mujoco.MjvOption()
        self._glow = [(self._model.material(name).id, share) for name, share in GLOWING.items()]
        self._columns = [self._model.geom(f"{COLUMN_PREFIX}{k}").id for k in range(NUM_COLUMNS)]

    def render(
        self,
        qpos: F64,
        place: F64,
        time_s: float,
        colour: tuple[float, float, float],
        pulse: float,
        levels: F64,
    ) -> NDArray[np.uint8]:
        """Return one picture, (height, width, 3).

        Args:
            qpos: (36,) state.
            place: (2,) [m] where the camera looks on the floor.
            time_s: Of the show, for the camera's slow orbit.
            colour: Of the dance, 0..1 each.
            pulse: 1 on the beat, falling to 0.
            levels: (NUM_COLUMNS,) 0..1, how high the columns of light behind the stage are.
        """
        self._data.qpos[:] = qpos
        heights = 0.06 + COLUMN_HEIGHT_M * levels
        self._model.geom_size[self._columns, 2] = 0.5 * heights
        self._model.geom_pos[self._columns, 2] = 0.5 * heights
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        for material, share in self._glow:
            self._model.mat_rgba[material, :3] = share * np.asarray(colour)
            self._model.mat_emission[material] = 0.35 + share * 0.65 * pulse
        camera = self._camera
        camera.lookat[:] = (place[0], place[1], LOOK_HEIGHT_M)
        camera.distance = DISTANCE_M
        swing = np.sin(2.0 * np.pi * time_s / ORBIT_PERIOD_S)
        camera.azimuth = AZIMUTH_DEG + ORBIT_DEG * swing
        camera.elevation = ELEVATION_DEG
        self._renderer.update_scene(self._data, camera, self._option)
        scene = self._renderer.scene
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self.quality.has_shadows
        scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = self.quality.has_reflections
        if not self.quality.has_shadows:
            self._add_soft_shadows(scene)
        return self._renderer.render()

    def close(self) -> None:
        """Close the GL context."""
        self._renderer.close()

    def _add_soft_shadows(self, scene: Any) -> None:
        """Draw discs under body and feet; a foot's is smaller and darker the lower it is."""
        pelvis = self._data.qpos[:3]
        for ring in range(4):
            _add_disc(scene, pelvis[0], pelvis[1], 0.10 + 0.06 * ring, 0.0010 + 1e-4 * ring, 0.16)
        for name in FEET:
            x, y, z = self._data.body(name).xpos
            lift = float(np.clip((z - 0.035) / 0.15, 0.0, 1.0))
            for ring in range(3):
                radius = 0.07 + 0.035 * ring + 0.05 * lift
                _add_disc(scene, x + 0.03, y, radius, 0.0015 + 1e-4 * ring, 0.25 * (1 - lift))


def _add_disc(scene: Any, x: float, y: float, radius: float, z: float, alpha: float) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    mujoco.mjv_initGeom(
        scene.geoms[scene.ngeom],
        mujoco.mjtGeom.mjGEOM_CYLINDER,
        np.array([radius, 2e-5, 0.0]),
        np.array([x, y, z]),
        np.eye(3).ravel(),
        np.array([0.0, 0.0, 0.0, alpha], np.float32),
    )
    scene.ngeom += 1


def best_scene(qpos: F64, budget_ms: float) -> Scene:
    """Return a scene of the best quality of which a frame costs no more than the budget."""
    for quality in QUALITIES[:-1]:
        scene = Scene(quality)
        if _frame_cost_ms(scene, qpos) <= budget_ms:
            return scene
        scene.close()
    return Scene(QUALITIES[-1])


def _frame_cost_ms(scene: Scene, qpos: F64) -> float:
    """Return the fastest of three frames; the first ever also loads things and does not count."""
    costs_ms = []
    for _ in range(4):
        start_s = time.perf_counter()
        scene.render(qpos, qpos[:2], 0.0, (0.3, 0.8, 0.9), 0.0, np.ones(NUM_COLUMNS))
        costs_ms.append((time.perf_counter() - start_s) * 1e3)
    return min(costs_ms[1:])


def states_at(utime: NDArray[np.int64], qpos: F64, wanted: NDArray[np.int64]) -> F64:
    """Return states at times in between, (n, 36): linear, quaternions renormalised.

    Args:
        utime: (m,) [us] of the known states.
        qpos: (m, 36).
        wanted: (n,) [us]; outside the known times the nearest state is taken.
    """
    index = np.clip(np.searchsorted(utime, wanted, side="right") - 1, 0, utime.size - 2)
    gap = (utime[index + 1] - utime[index]).astype(np.float64)
    share = np.clip((wanted - utime[index]) / gap, 0.0, 1.0)[:, None]
    before, after = qpos[index], qpos[index + 1].copy()
    flipped = np.sum(before[:, 3:7] * after[:, 3:7], axis=1) < 0.0
    after[flipped, 3:7] *= -1.0
    states = (1.0 - share) * before + share * after
    states[:, 3:7] /= np.linalg.norm(states[:, 3:7], axis=1, keepdims=True)
    return states


def smooth_places(states: F64, fps: float) -> F64:
    """Return where the camera looks per frame, (n, 2) [m]: the robot's place, smoothed."""
    half = max(1, round(2 * FOLLOW_S * fps))
    kernel = np.exp(-0.5 * (np.arange(-half, half + 1) / (FOLLOW_S * fps)) ** 2)
    kernel /= kernel.sum()
    padded = np.pad(states[:, :2], ((half, half), (0, 0)), mode="edge")
    columns = [np.convolve(padded[:, axis], kernel, mode="valid") for axis in range(2)]
    return np.stack(columns, axis=1)
