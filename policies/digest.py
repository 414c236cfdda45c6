"""What a skill does, as a hash: proofs name the skills they are about."""

from __future__ import annotations

from hashlib import blake2b

from downbeat.policies.manifest import SkillManifest


def skill_digest(manifest: SkillManifest) -> str:
    """Return a hash of everything that a skill does: its files and how it is played."""
    digest = blake2b(digest_size=8)
    for path in (manifest.onnx_path, *(manifest.folder / name for name in manifest.extra_files)):
        digest.update(path.read_bytes())
    facts = (manifest.name, manifest.kind, manifest.bpm, manifest.duration_s, manifest.loop)
    facts = (*facts, manifest.tempo_range_bpm)
    digest.update(repr((*facts, manifest.policy, manifest.command)).encode())
    return digest.hexdigest()
