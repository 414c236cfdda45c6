"""A network without metadata and a description that somebody wrote for it, in our own words.

`NAME.toml` beside `NAME.onnx` holds the `[policy]` table of a manifest (policies/spec.py) and, for
a locomotion policy, `[command]` with the ranges vx, vy, yaw_rate.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.build import check_against_network, command_ranges
from downbeat.policies.importers.context import Draft, ImportContext
from downbeat.policies.importers.files import checked_file
from downbeat.policies.importers.motion import read_tables
from downbeat.policies.importers.network import Network
from downbeat.policies.spec_toml import spec_from_table
from downbeat.policies.toml_fields import check_keys

MAX_BYTES = 1_000_000
RATE_HZ = 50.0
KEYS = ("vx", "vy", "yaw_rate")


def _description(network: Network) -> Path:
    return network.path.with_suffix(".toml")


def recognises(network: Network) -> bool:
    """Whether a description of this kind lies beside the file."""
    path = _description(network)
    if not path.is_file() or path.stat().st_size > MAX_BYTES:
        return False
    return b"[policy" in path.read_bytes()


def import_policy(ctx: ImportContext, network: Network) -> Draft:
    """Read the network as its description says.

    Raises:
        PolicyError: The description is wrong or contradicts the network.
    """
    path = checked_file(_description(network), network.path.parent, MAX_BYTES)
    try:
        table: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise PolicyError(f"{path} cannot be read: {error}.") from error
    check_keys(table, {"policy", "command", "licence"}, {"policy"}, str(path))
    spec = check_against_network(spec_from_table(table["policy"], f"{path}:policy"), network)
    ctx.note(f"everything = as described: {path.name} beside the network")
    licence = str(table.get("licence", ""))
    if spec.motion is None:
        if not spec.takes_command:
            raise PolicyError(f"{path} describes neither a motion nor a velocity command.")
        ranges = command_ranges(ctx, table.get("command"), KEYS)
        period = spec.gait.period_s if spec.gait is not None else 1.0
        return Draft(spec, network.path, "locomotion", period, command=ranges, licence=licence)
    motion = spec.motion
    tables = read_tables(network.path.parent / motion.file, network.path.parent)
    rows = len(tables["joint_pos"])
    if rows != motion.rows or motion.rate_hz != RATE_HZ or motion.file != "motion.npz":
        raise PolicyError(
            f"{path}:policy.motion describes {motion.rows} rows at {motion.rate_hz:g} Hz in "
            f"{motion.file}; motion.npz with its {rows} rows at {RATE_HZ:g} Hz is valid."
        )
    return Draft(spec, network.path, "tracking", rows / RATE_HZ, tables, licence=licence)
