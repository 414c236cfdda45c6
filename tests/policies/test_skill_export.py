from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from downbeat.catalog.robot import load_g1
from downbeat.policies.generator.export import (
    MAX_CORRECTION_RAD,
    CommandGrid,
    Tables,
    make_tables,
    write_onnx,
)
from downbeat.policies.manifest import load_skills

TICKS = 7
GRID = CommandGrid(vx=(-0.15, 0.0, 0.3), yaw_rate=(-0.3, 0.0, 0.3))


def random_tables(gaits: int, seed: int = 0) -> Tables:
    rng = np.random.default_rng(seed)
    return make_tables(
        [rng.normal(size=(TICKS, 29)) for _ in range(gaits)],
        [rng.normal(size=(TICKS, 64)) for _ in range(gaits)],
        [0.03 * rng.normal(size=(TICKS, 29, 64)) for _ in range(gaits)],
    )


def numpy_actions(
    tables: Tables, obs: np.ndarray, time_step: float, weights: np.ndarray
) -> np.ndarray:
    """The reference implementation: double precision, straight from the definition."""
    phase = time_step % TICKS
    row, share = int(phase), phase - int(phase)
    following = (row + 1) % TICKS

    def mix(table: np.ndarray) -> np.ndarray:
        both = (1.0 - share) * table[row].astype(float) + share * table[following].astype(float)
        return weights @ both

    rows, gain = mix(tables.rows), mix(tables.gains).reshape(29, 64)
    limit = MAX_CORRECTION_RAD / load_g1().action_scale
    return rows[:29] + np.clip(gain @ (obs - rows[29:]), -limit, limit)


class Opened:
    def __init__(self, path: Path) -> None:
        self.session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])

    def run(self, obs: np.ndarray, time_step: float, *command: float) -> dict[str, np.ndarray]:
        feeds = {"obs": obs[None].astype(np.float32), "time_step": np.float32([[time_step]])}
        if command:
            feeds["command"] = np.float32([command])
        names = ["actions", "joint_pos", "joint_vel"]
        return dict(zip(names, (out[0] for out in self.session.run(names, feeds))))


@pytest.fixture(scope="module")
def dance(tmp_path_factory: pytest.TempPathFactory) -> tuple[Opened, Tables]:
    tables = random_tables(1)
    path = tmp_path_factory.mktemp("dance") / "dance.onnx"
    write_onnx(path, "dance", tables)
    return Opened(path), tables


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> tuple[Opened, Tables]:
    tables = random_tables(9)
    path = tmp_path_factory.mktemp("walk") / "walk.onnx"
    write_onnx(path, "walk", tables, GRID)
    return Opened(path), tables


@pytest.mark.parametrize("time_step", [0.0, 0.25, 3.0, 5.9375, 6.5, 6.96875, 7.0, 13.5, 700.25])
def test_onnx_equals_the_numpy_reference(dance: tuple[Opened, Tables], time_step: float) -> None:
    opened, tables = dance
    obs = np.random.default_rng(1).normal(size=64)
    found = opened.run(obs, time_step)["actions"]
    wanted = numpy_actions(tables, obs, time_step, np.ones(1))
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_feedback_cannot_move_a_target_further_than_its_limit(
    dance: tuple[Opened, Tables],
) -> None:
    opened, tables = dance
    found = opened.run(np.full(64, 1e3), 2.0)["actions"]
    moved = (found - tables.rows[2, 0, :29]) * load_g1().action_scale
    np.testing.assert_allclose(np.abs(moved), MAX_CORRECTION_RAD, rtol=1e-5)


def test_the_phase_wraps_exactly(dance: tuple[Opened, Tables]) -> None:
    obs = np.random.default_rng(2).normal(size=64)
    for time_step in (0.0, 0.5, 2.25, 6.75):
        once, later = (dance[0].run(obs, time_step + k * TICKS) for k in (0, 3))
        for name, value in once.items():
            np.testing.assert_array_equal(value, later[name])


def test_the_loop_has_no_seam(dance: tuple[Opened, Tables]) -> None:
    obs = np.zeros(64)
    before, after = (dance[0].run(obs, t)["joint_pos"] for t in (TICKS - 2**-12, 0.0))
    np.testing.assert_allclose(before, after, atol=2e-3)


def test_reference_outputs_are_the_observation_reference(dance: tuple[Opened, Tables]) -> None:
    opened, tables = dance
    out = opened.run(np.zeros(64), 3.0)
    np.testing.assert_array_equal(out["joint_pos"], tables.rows[3, 0, 35:64])
    np.testing.assert_array_equal(out["joint_vel"], tables.rows[3, 0, 64:93])


def test_actions_are_scaled_offsets_from_the_default_pose(dance: tuple[Opened, Tables]) -> None:
    robot = load_g1()
    target = np.linspace(-1.0, 1.0, 29)
    tables = make_tables([np.tile(target, (2, 1))], [np.zeros((2, 64))], [np.zeros((2, 29, 64))])
    recovered = robot.default_joint_pos + robot.action_scale * tables.rows[0, 0, :29]
    np.testing.assert_allclose(recovered, target, atol=1e-6)


@pytest.mark.parametrize(
    ("vx", "yaw_rate", "weights"),
    [
        (-0.15, -0.3, {0: 1.0}),
        (0.0, 0.0, {4: 1.0}),
        (0.3, 0.3, {8: 1.0}),
        (0.15, 0.0, {4: 0.5, 7: 0.5}),
        (-0.075, 0.15, {1: 0.25, 2: 0.25, 4: 0.25, 5: 0.25}),
        (9.0, -9.0, {6: 1.0}),
    ],
)
def test_gaits_are_blended_bilinearly_and_commands_are_clipped(
    walk: tuple[Opened, Tables], vx: float, yaw_rate: float, weights: dict[int, float]
) -> None:
    opened, tables = walk
    obs = np.random.default_rng(3).normal(size=64)
    mixture = np.zeros(9)
    for index, weight in weights.items():
        mixture[index] = weight
    found = opened.run(obs, 2.5, vx, 0.0, yaw_rate)["actions"]
    wanted = numpy_actions(tables, obs, 2.5, mixture)
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_metadata_names_joints_gains_and_terms_like_beyondmimic() -> None:
    robot = load_g1()
    model = onnx.load(load_skills()["kpop"].onnx_path)
    props = {prop.key: prop.value for prop in model.metadata_props}
    assert props["joint_names"].split(",") == list(robot.joint_names)
    assert props["observation_names"] == "projected_gravity,base_ang_vel,joint_pos,joint_vel"
    for key in ("joint_stiffness", "joint_damping", "default_joint_pos", "action_scale"):
        found = [float(text) for text in props[key].split(",")]
        np.testing.assert_allclose(found, getattr(robot, key), rtol=1e-6)
    assert props["time_step_total"] == str(load_skills()["kpop"].ticks)
