"""What an importer works with: the path, what the user set, and what had to be inferred."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from downbeat.policies.errors import PolicyError
from downbeat.policies.spec import MotionSpec, PolicySpec
from downbeat.runtime.errors import one_of

Profile = TypeVar("Profile")
RATE_HZ = 50.0


@dataclass
class ImportContext:
    """One import under way.

    Attributes:
        path: What the user named: a file or the author's folder.
        name: Name of the skill to be.
        profile: Named profile that the user asked for; empty: none.
        profiles: Names of the profiles that would have been valid, known after the import.
        settings: `--set key=value` of the user, parsed.
        inferred: "field = value: from where", for everything not found in the policy's own files.
        known: Keys that the importer would take from the user.
    """

    path: Path
    name: str
    profile: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    inferred: list[str] = field(default_factory=list)
    known: set[str] = field(default_factory=set)
    profiles: set[str] = field(default_factory=set)

    def pick(self, profiles: Mapping[str, Profile], default: str) -> tuple[str, Profile | None]:
        """Return (name, profile): the one that the user asked for, or the family's default.

        Args:
            profiles: All of the family.
            default: Name of the default; one that is not among them: none.

        Raises:
            PolicyError: The user asked for one that the family does not have.
        """
        self.profiles |= set(profiles)
        if self.profile and self.profile not in profiles:
            raise PolicyError(
                f"Profile '{self.profile}' does not apply to {self.path}; valid are "
                f"{one_of(profiles)} (--profile)."
            )
        name = self.profile or default
        return name, profiles.get(name)

    def setting(self, key: str) -> Any:
        """Return what the user set for `key`, None if nothing."""
        self.known.add(key)
        return self.settings.get(key)

    def infer(self, key: str, value: Any, source: str) -> Any:
        """Return what the user set for `key`, else `value`; says where it came from."""
        given = self.setting(key)
        if given is not None:
            value, source = given, "--set"
        self.inferred.append(f"{key} = {_short(value)}: {source}")
        return value

    def found(self, key: str, value: Any) -> Any:
        """Return what the user set for `key`, else what the policy's own files say."""
        return value if self.setting(key) is None else self.infer(key, value, "--set")

    def note(self, line: str) -> None:
        """Record a "field = value: from where" that cannot be set."""
        self.inferred.append(line)

    def need(self, key: str, alternatives: str) -> PolicyError:
        """Return the error for a field that nobody supplies."""
        return PolicyError(
            f"{self.path} does not say {key}; {alternatives}, or give it with --set {key}=VALUE."
        )

    def check_settings(self) -> None:
        """Refuse `--set` keys that this importer does not know.

        Raises:
            PolicyError: Names the key and the valid ones.
        """
        unknown = sorted(set(self.settings) - self.known)
        if unknown:
            raise PolicyError(
                f"'{unknown[0]}' cannot be set for {self.path}; valid are {one_of(self.known)} "
                "(--set)."
            )
        if self.profile and self.profile not in self.profiles:
            raise PolicyError(
                f"{self.path} needs no profile, '{self.profile}' does not apply; valid are "
                f"{one_of(self.profiles)} (--profile)."
            )


@dataclass(frozen=True)
class Draft:
    """What an importer found: everything but the files' digests.

    Attributes:
        spec: How the network is fed.
        onnx: The network's file.
        kind: "tracking" or "locomotion".
        duration_s: Length of the motion [s]; of a locomotion policy its gait period.
        motion: Tables of the reference motion, None without one.
        command: (vx, vy, yaw_rate) ranges; None without a command.
        licence: SPDX name or what the file says; empty: not said.
    """

    spec: PolicySpec
    onnx: Path
    kind: str
    duration_s: float
    motion: Mapping[str, Any] | None = None
    command: tuple[tuple[float, float], ...] | None = None
    licence: str = ""

    @classmethod
    def tracking(
        cls, spec: PolicySpec, onnx: Path, motion: Mapping[str, Any], anchor: str
    ) -> Draft:
        """Return the draft of a policy that follows a motion."""
        rows = len(motion["joint_pos"])
        about = MotionSpec("motion.npz", rows, RATE_HZ, anchor)
        return cls(replace(spec, motion=about), onnx, "tracking", rows / RATE_HZ, motion)


def parse_settings(items: Sequence[str]) -> dict[str, Any]:
    """Parse `key=value` items; values are numbers, lists of numbers (1,2,3), lists or texts.

    Raises:
        PolicyError: An item has no '='.
    """
    settings: dict[str, Any] = {}
    for item in items:
        key, sep, text = item.partition("=")
        if not sep or not key.strip():
            raise PolicyError(f"'{item}' is not key=value (--set).")
        settings[key.strip()] = _parsed(text)
    return settings


def _parsed(text: str) -> Any:
    for form in (text, f"[{text}]"):
        try:
            return tomllib.loads(f"value = {form}")["value"]
        except tomllib.TOMLDecodeError:
            continue
    return text.strip()


def _short(value: Any, length: int = 100) -> str:
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= length else f"{text[: length - 3]}..."
