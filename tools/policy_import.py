"""`downbeat policy import`: a public policy becomes a skill of ours, checked to the last number."""

from __future__ import annotations

import json
import resource
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from downbeat.control.golden import GOLDEN_NAME, verify_golden, write_golden
from downbeat.control.network import NetworkSkill
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.context import ImportContext, parse_settings
from downbeat.policies.importers.detect import read_policy
from downbeat.policies.importers.package import (
    skill_name,
    source_of,
    staging,
    write_skill,
)
from downbeat.policies.manifest import SkillManifest, file_sha256, load_manifest, load_skills
from downbeat.policies.toml_edit import set_files
from downbeat.tools.policy_inspect import print_policy

MAX_MEMORY_BYTES = 4_000_000_000
"""Beyond what the process holds when an import begins."""


def import_policy(
    path: Path,
    out: Path,
    name: str = "",
    profile: str = "",
    settings: Sequence[str] = (),
    licence: str = "",
) -> SkillManifest:
    """Import one policy and return its manifest.

    Raises:
        DownbeatError: One sentence: what is missing or contradicts, and what would be valid.
    """
    chosen = name or _own_name(path.resolve())
    ctx = ImportContext(path, chosen, profile, parse_settings(settings))
    with _bounded_memory():
        draft = read_policy(ctx)
    with _bounded_memory(), staging(out, ctx.name, source_of(ctx)) as folder:
        manifest = write_skill(ctx, draft, folder, licence)
        golden = write_golden(_open(manifest, path))
        set_files(
            folder / "manifest.toml",
            (*manifest.extra_files, GOLDEN_NAME),
            (*manifest.extra_sha256, file_sha256(golden)),
        )
        verify_golden(NetworkSkill(load_manifest(folder / "manifest.toml")))
    return load_manifest(out / ctx.name / "manifest.toml")


def _own_name(path: Path) -> str:
    """Return a name that none of our own skills has: an import must not replace one unasked."""
    name = skill_name(path)
    return f"imported_{name}" if name in load_skills() else name


@contextmanager
def _bounded_memory() -> Iterator[None]:
    """Let a network that asks for more memory than any policy needs fail, not the machine."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:  # not Linux
        yield
        return
    wanted = pages * resource.getpagesize() + MAX_MEMORY_BYTES
    limits = [wanted, *(value for value in (soft, hard) if value != resource.RLIM_INFINITY)]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
    try:
        yield
    except MemoryError as error:
        raise PolicyError(
            f"The policy asks for more than {MAX_MEMORY_BYTES // 10**9} GB of memory."
        ) from error
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _open(manifest: SkillManifest, origin: Path) -> NetworkSkill:
    """Open a skill for the first time; nothing is known yet about how its network runs."""
    try:
        return NetworkSkill(manifest)
    except Exception as error:  # onnxruntime raises a dozen types of its own
        line = " ".join(str(error).split()).replace(str(manifest.onnx_path), str(origin))
        raise PolicyError(f"{origin} cannot be run: {line[:400].rstrip('.')}.") from error


def import_command(
    path: Path,
    out: Path,
    name: str,
    profile: str,
    settings: Sequence[str],
    licence: str,
    as_json: bool,
) -> int:
    """`downbeat policy import`."""
    manifest = import_policy(path, out, name, profile, settings, licence)
    if as_json:
        print(json.dumps(_summary(manifest)))
        return 0
    print_policy(manifest, Console(markup=False, highlight=False))
    print(f"imported: {manifest.folder}")
    print(f"certify it: downbeat policy certify {manifest.name} --skills {out} --write")
    return 0


def _summary(manifest: SkillManifest) -> dict[str, Any]:
    spec = manifest.policy
    return {
        "name": manifest.name,
        "folder": str(manifest.folder),
        "kind": manifest.kind,
        "duration_s": manifest.duration_s,
        "dialect": "" if spec is None else spec.dialect,
        "joints": 0 if spec is None else spec.num_joints,
        "inferred": list(manifest.inferred),
    }
