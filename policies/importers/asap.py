"""ASAP and PBHC: a motion known by heart, 380 observations of which 304 are the last four ticks."""

from __future__ import annotations

from pathlib import Path

from downbeat.catalog.robot import load_g1
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.build import (
    action_output,
    check_against_network,
    held_joints,
    joints,
    obs_input,
)
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.network import Network
from downbeat.policies.importers.profiles import ASAP, ASAP_MOTIONS
from downbeat.policies.importers.values import positive
from downbeat.policies.spec import InputSpec, PolicySpec, TermSpec
from downbeat.runtime.errors import one_of

NUM_OBS, NUM_ACTIONS = 380, 23
HISTORY = 4
ACTION_SCALE = 0.25
ACTION_CLIP = 100.0
WRISTS = "wrist"
NOW = (
    TermSpec("last_action"),
    TermSpec("base_ang_vel", (0.25,)),
    TermSpec("joint_pos_rel"),
    TermSpec("joint_vel", (0.05,)),
)
THEN = (TermSpec("projected_gravity"), TermSpec("motion_phase"))
"""The network sees its terms in alphabetical order; the history of all lies in between."""


def recognises(network: Network) -> bool:
    """Whether the shapes are those of the family."""
    inputs, outputs = list(network.inputs.values()), list(network.outputs.values())
    return (
        not network.metadata
        and [shape[-1:] for shape in inputs] == [(NUM_OBS,)]
        and (NUM_ACTIONS,) in [shape[-1:] for shape in outputs]
    )


def import_policy(ctx: ImportContext, network: Network) -> Draft:
    """Read one file.

    Raises:
        PolicyError: Neither the file's name nor the user says which body and how long.
    """
    known, length = _known(network.path)
    name, profile = ctx.pick(ASAP, known)
    if profile is None:
        raise PolicyError(
            f"{network.path} does not say which body and gains it was trained with; give one of "
            f"{one_of(ASAP)} with --profile."
        )
    source = f"built-in profile {name}"
    if length is None and ctx.setting("motion.duration_s") is None:
        raise ctx.need("motion.duration_s", "only the phase of its motion is an input")
    found = ctx.infer("motion.duration_s", length, f"{source}, {network.path.name}")
    duration = positive(found, "--set motion.duration_s")
    names = [joint for joint in load_g1().joint_names if WRISTS not in joint]
    ctx.note(f"joint_names = {len(names)}, all but the wrists, motor order: {source}")
    ctx.note(f"observation terms = the family's block of {NUM_OBS}: {source}")
    ctx.note(f"history = {HISTORY} ticks before this one, newest first, zeros at first: {source}")
    ctx.note(f"action_clip = -{ACTION_CLIP:g}..{ACTION_CLIP:g}: {source}")
    table = {
        "default_joint_pos": profile.default_joint_pos,
        "joint_stiffness": profile.joint_stiffness,
        "joint_damping": profile.joint_damping,
        "action_scale": ACTION_SCALE,
    }
    for key, value in table.items():
        ctx.infer(key, value, source)
    moved = joints(
        ctx,
        names,
        profile.default_joint_pos,
        profile.joint_stiffness,
        profile.joint_damping,
        ACTION_SCALE,
        profile.default_joint_pos,
        str(network.path),
    )
    past = tuple(
        TermSpec(term.name, term.scale, history=HISTORY, past=True) for term in (*NOW, *THEN)
    )
    inputs = InputSpec(
        obs_input(network),
        (*NOW, *past, *THEN),
        history_order="newest_first",
        history_fill="zero",
    )
    spec = PolicySpec(
        dialect="asap",
        inputs=(inputs,),
        action_output=action_output(network, NUM_ACTIONS),
        joint_names=moved.names,
        default_joint_pos=moved.default,
        action_scale=moved.scale,
        action_offset=moved.offset,
        joint_stiffness=moved.stiffness,
        joint_damping=moved.damping,
        action_clip=(-ACTION_CLIP, ACTION_CLIP),
        held=held_joints(ctx, moved.names),
        phase_duration_s=duration,
    )
    check_against_network(spec, network)
    return Draft(spec, network.path, "tracking", duration)


def _known(path: Path) -> tuple[str, float | None]:
    for part in (path.stem, path.resolve().parent.name):
        if part.lower() in ASAP_MOTIONS:
            return ASAP_MOTIONS[part.lower()]
    return "", None
