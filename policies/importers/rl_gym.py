"""unitree_rl_gym: a network of 47 observations, its numbers in g1.yaml beside it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.build import (
    check_against_network,
    command_ranges,
    held_joints,
    joints,
    recurrent_pairs,
)
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.network import Network
from downbeat.policies.importers.profiles import RL_GYM, RlGymProfile
from downbeat.policies.importers.safe_yaml import read_yaml
from downbeat.policies.importers.values import finite, positive
from downbeat.policies.spec import (
    GaitSpec,
    InputSpec,
    PolicySpec,
    TermSpec,
)

NUM_OBS, NUM_ACTIONS = 47, 12
TICK_S = 0.02
CONFIG_NAME = "g1.yaml"
FROM_YAML = (
    "kps",
    "kds",
    "default_angles",
    "ang_vel_scale",
    "dof_pos_scale",
    "dof_vel_scale",
    "action_scale",
    "cmd_scale",
)
RANGES = ((-0.4, 0.8), (-0.3, 0.3), (-0.8, 0.8))


def recognises(network: Network) -> bool:
    """Whether the shapes are those of the family."""
    widths = [shape[-1] for shape in network.inputs.values() if shape]
    actions = [shape[-1] for shape in network.outputs.values() if shape]
    return not network.metadata and NUM_OBS in widths and NUM_ACTIONS in actions


def import_policy(ctx: ImportContext, network: Network) -> Draft:
    """Read one file.

    Raises:
        PolicyError: Names the field that is missing or contradicts.
    """
    name, found = ctx.pick(RL_GYM, "unitree_rl_gym_g1")
    profile = cast(RlGymProfile, found)
    source = f"built-in profile {name}"
    values = _numbers(ctx, network.path.with_name(CONFIG_NAME), profile, source)
    ctx.note(f"joint_names = 12 legs, motor order: {source}")
    given = ctx.infer("gait.period_s", profile.gait_period_s, source)
    period = positive(given, "gait.period_s")
    ctx.note(f"observation terms = the family's block of {NUM_OBS}: {source}")
    moved = joints(
        ctx,
        profile.joint_names,
        values["default_angles"],
        values["kps"],
        values["kds"],
        values["action_scale"],
        values["default_angles"],
        str(network.path),
    )
    terms = (
        TermSpec("base_ang_vel", (values["ang_vel_scale"],)),
        TermSpec("projected_gravity"),
        TermSpec("velocity_commands", finite(values["cmd_scale"], str(network.path))),
        TermSpec("joint_pos_rel", (values["dof_pos_scale"],)),
        TermSpec("joint_vel", (values["dof_vel_scale"],)),
        TermSpec("last_action"),
        TermSpec("gait_phase"),
    )
    obs_input = next(n for n, shape in network.inputs.items() if shape[-1] == NUM_OBS)
    action = next(n for n, shape in network.outputs.items() if shape[-1] == NUM_ACTIONS)
    spec = PolicySpec(
        dialect="unitree_rl_gym",
        inputs=(InputSpec(obs_input, terms),),
        action_output=action,
        joint_names=moved.names,
        default_joint_pos=moved.default,
        action_scale=moved.scale,
        action_offset=moved.offset,
        joint_stiffness=moved.stiffness,
        joint_damping=moved.damping,
        held=held_joints(ctx, moved.names),
        recurrent=recurrent_pairs(network, (obs_input,), action),
        gait=GaitSpec(period, start=TICK_S / period),
    )
    check_against_network(spec, network)
    keys = ("vx", "vy", "yaw_rate")
    for key, low_high in zip(keys, RANGES, strict=True):
        ctx.infer(f"command.{key}", low_high, source)
    command = command_ranges(ctx, dict(zip(keys, RANGES, strict=True)), keys)
    return Draft(spec, network.path, "locomotion", period, command=command)


def _numbers(
    ctx: ImportContext, config: Path, profile: RlGymProfile, source: str
) -> dict[str, Any]:
    """Return the author's numbers from g1.yaml, or the profile's where there is no such file."""
    values: dict[str, Any] = {key: asdict(profile)[key] for key in FROM_YAML}
    if not config.is_file():
        ctx.note(f"gains, defaults, scales = the family's: {source}, no {CONFIG_NAME} beside it")
        return values
    table = read_yaml(config)
    for key, wanted in (("num_obs", NUM_OBS), ("num_actions", NUM_ACTIONS)):
        if table.get(key, wanted) != wanted:
            raise PolicyError(
                f"{config}:{key} is {table[key]}, the network beside it has {wanted}."
            )
    for key in FROM_YAML:
        if key not in table:
            raise ctx.need(key, f"{config} lacks it")
        values[key] = table[key]
    for key in ("ang_vel_scale", "dof_pos_scale", "dof_vel_scale", "action_scale"):
        values[key] = finite([values[key]], f"{config}:{key}")[0]
    ctx.note(f"gains, defaults, scales = the author's: {CONFIG_NAME} beside the network")
    return values
