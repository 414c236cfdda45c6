"""The question to the checker: the plan, the robot's state, and all that control remembers."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from downbeat.control.director import Director
from downbeat.control.observation import RobotState
from downbeat.control.phase import TICK_S
from downbeat.control.prover import ProofConfig, Question
from downbeat.control.rotations import quat_rotate
from downbeat.control.tick import TickInput, hash64
from downbeat.lcm_types import transition_query_t

PROFILE = "stage"


def transition_query(
    inputs: TickInput,
    state: RobotState,
    question: Question,
    director: Director,
    proof: ProofConfig,
    memory: bytes,
) -> transition_query_t:
    """Return the TRANSITION_QUERY of a question.

    Args:
        inputs: Of this tick.
        state: The robot, measured and estimated.
        question: What is to be checked.
        director: Whose plan it is.
        proof: Rollouts and horizon.
        memory: The serialised director, and what it sent last.
    """
    plan = question.chosen.plan
    playback = director.playback
    query: Any = transition_query_t()
    query.header.utime = inputs.utime
    query.query_id = question.query_id
    query.request_id = question.chosen.key[1]
    query.deadline_utime = question.deadline_utime
    query.state_seq = 0 if inputs.state is None else inputs.state.header.seq
    query.from_skill = "" if playback is None else playback.name
    query.to_skill = plan.hop.to_skill
    query.exit_utime = plan.hop.start_utime
    query.entry_phase_s = max(plan.hop.shift_s, 0.0)
    query.blend_s = plan.hop.blend_ticks * TICK_S
    query.mode = plan.mode
    query.num_rollouts = question.rollouts
    query.horizon_s = proof.horizon_s
    query.seed = question.query_id
    query.profile = PROFILE
    query.qpos, query.qvel = estimated_state(state)
    query.control_state = memory
    query.num_bytes = len(memory)
    query.control_state_hash = hash64(np.frombuffer(memory, np.uint8))
    return cast(transition_query_t, query)


def estimated_state(state: RobotState) -> tuple[list[float], list[float]]:
    """Return qpos (36) and qvel (35) as MuJoCo has them, of what control believes."""
    zero = np.zeros(3, np.float32)
    place = zero if state.base_pos is None else state.base_pos
    speed = zero if state.base_lin_vel is None else state.base_lin_vel
    world = quat_rotate(state.base_quat_wxyz, np.asarray(speed, np.float32))
    qpos = np.concatenate([place, state.base_quat_wxyz, state.joint_pos])
    qvel = np.concatenate([world, state.base_ang_vel, state.joint_vel])
    return [float(v) for v in qpos], [float(v) for v in qvel]
