"""Skills of a batch are control's own skills: same states, same targets, tick by tick."""

from pathlib import Path

import numpy as np
import pytest

from downbeat.catalog.robot import load_g1
from downbeat.control.observation import RobotState
from downbeat.control.phase import TICK_S, PhaseLine
from downbeat.control.player import start_playback
from downbeat.control.policy import open_skill
from downbeat.control.transitions import Hop
from downbeat.policies.manifest import load_skills
from downbeat.sim.batch.ort import open_batched
from downbeat.sim.batch.skills import batch_skill
from downbeat.sim.batch.steering import begin_steering, steer
from downbeat.tools.policy_import import import_policy

BUNDLED = load_skills()
POLICIES = Path(__file__).resolve().parents[4] / "shared" / "policies"
FOREIGN = (
    "beyondmimic/waltz.onnx",
    "unitree_rl_lab/dance_102",
    "unitree_rl_lab/gangnam_style",
    "unitree_rl_lab/my_dance",
    "unitree_rl_lab/velocity",
    "unitree_rl_mjlab/velocity",
    "holosoma/ppo_g1_29dof.onnx",
    "unitree_rl_gym/lstm12.onnx",
)
ROBOTS, TICKS = 3, 40


def states(seed):
    """TICKS states of ROBOTS robots that sway and turn, with noise."""
    rng = np.random.default_rng(seed)
    default = np.asarray(load_g1().default_joint_pos, np.float32)
    quat = np.array([1.0, 0.0, 0.0, 0.0]) + rng.normal(0.0, 0.15, (ROBOTS, 4))
    for _ in range(TICKS):
        quat = quat + rng.normal(0.0, 0.02, quat.shape)
        unit = quat / np.linalg.norm(quat, axis=1, keepdims=True)
        yield RobotState(
            *(
                np.asarray(value, np.float32)
                for value in (
                    unit,
                    rng.normal(0.0, 0.5, (ROBOTS, 3)),
                    default + rng.normal(0.0, 0.2, (ROBOTS, 29)),
                    rng.normal(0.0, 1.0, (ROBOTS, 29)),
                    rng.normal(0.0, 0.3, (ROBOTS, 3)),
                    rng.normal(0.0, 0.5, (ROBOTS, 3)) + [0.0, 0.0, 0.75],
                )
            )
        )


def one(state, robot):
    """One robot's row of a state."""
    return RobotState(
        state.base_quat_wxyz[robot],
        state.base_ang_vel[robot],
        state.joint_pos[robot],
        state.joint_vel[robot],
        state.base_lin_vel[robot],
        state.base_pos[robot],
    )


def phases(manifest, rng):
    """(TICKS, ROBOTS) phases inside the skill, from near its end for the first robot."""
    length = manifest.duration_s
    begin = rng.uniform(0.0, length, ROBOTS)
    begin[0] = max(length - 0.4, 0.0)
    all_s = begin + np.arange(TICKS)[:, None] * TICK_S * rng.uniform(0.8, 1.2, ROBOTS)
    return np.mod(all_s, length) if manifest.loop else np.clip(all_s, 0.0, length)


def commands(manifest, rng):
    """(TICKS, ROBOTS, 3) commands that change, the last robot's zero at first."""
    if manifest.command is None:
        return np.zeros((TICKS, ROBOTS, 3), np.float32)
    low, high = np.array([manifest.command.vx, manifest.command.vy, manifest.command.yaw_rate]).T
    given = rng.uniform(low, high, (TICKS, ROBOTS, 3)).astype(np.float32)
    given[: TICKS // 2, -1] = 0.0
    return given


def worst_difference(manifest):
    """Largest difference of targets, references and gains between a batch and control."""
    rng = np.random.default_rng(len(manifest.name))
    batch, single = batch_skill(manifest, open_batched), open_skill(manifest)
    phase, command = phases(manifest, rng), commands(manifest, rng)
    memory, own = {}, []
    worst = 0.0
    for tick, state in enumerate(states(7)):
        if tick == 0:
            memory = batch.begin(state, phase[0], command[0], np)
            own = [single.begin(one(state, r), float(phase[0, r])) for r in range(ROBOTS)]
        memory, output = batch.step(memory, state, phase[tick], command[tick], np)
        for r in range(ROBOTS):
            wanted = single.step(own[r], one(state, r), float(phase[tick, r]), command[tick, r])
            pairs = [
                (output.joint_pos[r], wanted.targets.joint_pos),
                (batch.joint_stiffness, wanted.targets.joint_stiffness),
                (batch.joint_damping, wanted.targets.joint_damping),
            ]
            worst = max(worst, *(float(np.abs(a - b).max()) for a, b in pairs))
    return worst


@pytest.mark.parametrize("name", sorted(BUNDLED))
def test_a_bundled_skill_in_batch_is_controls_own(name):
    assert worst_difference(BUNDLED[name]) < 1e-4


@pytest.mark.parametrize("path", FOREIGN)
def test_an_imported_policy_in_batch_is_controls_own(path, tmp_path):
    if not (POLICIES / path).exists():
        pytest.skip("no ../shared/policies beside this checkout")
    manifest = import_policy(POLICIES / path, tmp_path)
    assert worst_difference(manifest) < 1e-4


@pytest.mark.parametrize("wanted", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.2, 0.0, 0.4)])
def test_velocity_commands_of_many_robots_are_controls_own(wanted):
    manifest = BUNDLED["walk"]
    single = open_skill(manifest)
    hop, line = Hop(0, "walk", 0), PhaseLine(0, 0.0, 1.0)
    own, memory = [], {}
    rng = np.random.default_rng(3)
    heading = rng.uniform(-np.pi, np.pi, ROBOTS)
    asked = np.array(wanted, np.float32)
    for tick, state in enumerate(states(11)):
        heading = heading + rng.normal(0.0, 0.1, ROBOTS)
        if tick == 0:
            memory = begin_steering(heading)
            own = [start_playback(single, hop, line, one(state, r), 0, 0) for r in range(ROBOTS)]
        if tick == TICKS // 2:
            asked = np.zeros(3, np.float32)
        memory, command = steer(manifest, memory, heading, asked)
        for r in range(ROBOTS):
            own[r].velocity.wanted[:] = asked
            assert command[r] == pytest.approx(own[r].velocity.update(heading[r]), abs=1e-5)
