"""Which importer reads what lies at a path."""

from __future__ import annotations

from pathlib import Path

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers import beyondmimic, holosoma, rl_gym, unitree
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.network import Network, read_network
from downbeat.runtime.errors import one_of

FORMATS = (
    "BeyondMimic or mjlab ONNX (metadata observation_names, joint_names)",
    "holosoma ONNX (metadata dof_names, kp, kd)",
    "a unitree_rl_lab or unitree_rl_mjlab folder (params/deploy.yaml, exported/policy.onnx)",
    "the unitree_rl_gym network (47 observations, 12 actions)",
)


def read_policy(ctx: ImportContext) -> Draft:
    """Read whatever lies at `ctx.path`.

    Raises:
        PolicyError: Nothing is there, it is not recognised, or it contradicts itself.
    """
    path = ctx.path
    if not path.exists():
        raise PolicyError(f"There is nothing at {path}.")
    folder = _unitree_folder(path)
    if folder is not None:
        draft = unitree.import_policy(ctx, folder)
    else:
        network = read_network(_onnx_file(path))
        draft = _from_network(ctx, network)
    ctx.check_settings()
    return draft


def _unitree_folder(path: Path) -> Path | None:
    if path.is_dir():
        return path if unitree.recognises(path) else None
    if path.name == "deploy.yaml" or path.parent.name == "exported":
        above = path.parent.parent
        return above if unitree.recognises(above) else None
    return None


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
    if beyondmimic.recognises(network):
        return beyondmimic.import_policy(ctx, network)
    if holosoma.recognises(network):
        return holosoma.import_policy(ctx, network)
    if rl_gym.recognises(network):
        return rl_gym.import_policy(ctx, network)
    shapes = ", ".join(f"{name} {list(shape)}" for name, shape in network.inputs.items())
    keys = one_of(network.metadata) if network.metadata else "none"
    raise PolicyError(
        f"{network.path} is not of a known format: inputs {shapes}, metadata {keys}; known are "
        f"{'; '.join(FORMATS)}."
    )
