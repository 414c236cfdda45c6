"""Which importer reads what lies at a path."""

from __future__ import annotations

from pathlib import Path

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers import asap, beyondmimic, holosoma, rl_gym, unitree, written
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.network import Network, read_network
from downbeat.runtime.errors import one_of

FORMATS = (
    "BeyondMimic or mjlab ONNX (metadata observation_names, joint_names)",
    "holosoma ONNX (metadata dof_names, kp, kd)",
    "a unitree_rl_lab or unitree_rl_mjlab folder (params/deploy.yaml, exported/policy.onnx)",
    "the unitree_rl_gym network (47 observations, 12 actions)",
    "an ASAP or PBHC motion (380 observations, 23 actions)",
    "any ONNX with a description of ours beside it (NAME.toml with a [policy] table)",
)


def read_policy(ctx: ImportContext) -> Draft:
    """Read whatever lies at `ctx.path`.

    Raises:
        PolicyError: Nothing is there, it is not recognised, or it contradicts itself.
    """
    path = ctx.path
    if not path.exists():
        raise PolicyError(f"There is nothing at {path}.")
    folder = _unitree_folder(path.absolute())
    if folder is not None:
        draft = unitree.import_policy(ctx, folder)
    else:
        draft = _from_network(ctx, read_network(_onnx_file(path)))
    ctx.check_settings()
    return draft


def _unitree_folder(path: Path) -> Path | None:
    """Return the author's folder, whichever part of it was named."""
    above = [path, path.parent] if path.is_dir() else [path.parent.parent]
    if path.is_dir() and path.name not in ("params", "exported"):
        above = [path]
    return next((folder for folder in above if unitree.recognises(folder)), None)


def _onnx_file(path: Path) -> Path:
    if path.is_file():
        return path
    files = sorted(path.glob("*.onnx"))
    if len(files) == 1:
        return files[0]
    inside = sorted(str(p.parent.parent.relative_to(path)) for p in path.rglob("deploy.yaml"))
    names = [file.name for file in files] or inside
    hint = f"; name one of {one_of(names)}" if names else ""
    raise PolicyError(f"{path} holds {len(files)} ONNX files, one is expected{hint}.")


def _from_network(ctx: ImportContext, network: Network) -> Draft:
    for importer in (written, beyondmimic, holosoma, rl_gym, asap):
        if importer.recognises(network):
            return importer.import_policy(ctx, network)
    shapes = ", ".join(f"{name} {list(shape)}" for name, shape in network.inputs.items())
    keys = one_of(network.metadata) if network.metadata else "none"
    raise PolicyError(
        f"{network.path} is not of a known format: inputs {shapes}, metadata {keys}; known are "
        f"{'; '.join(FORMATS)}."
    )
