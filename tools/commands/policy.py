"""`downbeat policy`: generate, import, convert, certify, inspect skills."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True)
class Generate:
    """Build a skill from its choreography, for a tempo."""

    name: tyro.conf.Positional[str]
    """Skill name, e.g. kpop."""
    bpm: float | None = None
    """Tempo; omitted: the choreography's own."""
    out: Path = Path("policies_out")
    """Folder that receives NAME/manifest.toml and NAME/NAME.onnx."""

    def run(self) -> int:
        """Build and print the manifest."""
        from downbeat.tools.policy_tools import generate

        return generate(self.name, self.bpm, self.out)


@dataclass(frozen=True)
class Certify:
    """Dance each skill 30 s in closed loop under noise and delay; print the table."""

    names: tyro.conf.Positional[list[str]] = field(default_factory=list)
    """Skill names; none: all bundled skills."""
    skills: Path | None = None
    """Folder of skills; omitted: the bundled ones."""
    write: bool = False
    """Write the certificates into the manifests."""

    def run(self) -> int:
        """Certify; 0 if all passed."""
        from downbeat.tools.policy_tools import certify

        return certify(self.names, self.skills, self.write)


@dataclass(frozen=True)
class Import:
    """Import a public policy from its authors' own layout; nothing of theirs is edited."""

    path: tyro.conf.Positional[Path]
    """ONNX file, or the folder as its authors publish it."""
    out: Path = Path("policies_imported")
    """Folder that receives NAME/manifest.toml and its files."""
    name: str = ""
    """Skill name; omitted: from the path."""
    profile: str = ""
    """Built-in profile for what the files do not say; omitted: the family's own."""
    set: list[str] = field(default_factory=list)
    """KEY=VALUE for a field that is missing or wrong, e.g. motion.start_s=2.8."""
    licence: str = ""
    """Licence of the policy (SPDX name), for the manifest."""
    json: bool = False
    """Print a summary as one JSON object."""

    def run(self) -> int:
        """Import and show."""
        from downbeat.tools.policy_import import import_command

        return import_command(
            self.path, self.out, self.name, self.profile, self.set, self.licence, self.json
        )


@dataclass(frozen=True)
class Convert:
    """Turn a TorchScript policy into ONNX with explicit state, checked against the original."""

    path: tyro.conf.Positional[Path]
    """TorchScript file (.pt); needs PyTorch (extra `models`)."""
    out: Path
    """ONNX file to write."""
    width: int = 0
    """Width of the observation; 0: the only one that runs."""

    def run(self) -> int:
        """Convert, compare, write."""
        from downbeat.tools.policy_convert import convert_command

        return convert_command(self.path, self.out, self.width)


@dataclass(frozen=True)
class Inspect:
    """Show skills: kind, tempo range, phases, certificate; of policies terms, joints, motion."""

    names: tyro.conf.Positional[list[str]] = field(default_factory=list)
    """Skill names, skill folders or foreign policies; none: a table of all skills."""
    skills: Path | None = None
    """Folder of skills; omitted: the bundled ones."""

    def run(self) -> int:
        """Print."""
        from downbeat.tools.policy_tools import inspect

        return inspect(self.names, self.skills)


@dataclass(frozen=True)
class Policy:
    """Skills: `generate`, `import`, `convert`, `certify`, `inspect`."""

    what: (
        Annotated[Generate, tyro.conf.subcommand("generate")]
        | Annotated[Import, tyro.conf.subcommand("import")]
        | Annotated[Convert, tyro.conf.subcommand("convert")]
        | Annotated[Certify, tyro.conf.subcommand("certify")]
        | Annotated[Inspect, tyro.conf.subcommand("inspect")]
    )

    def run(self) -> int:
        """Run the chosen command."""
        return self.what.run()
