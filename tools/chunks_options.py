"""What the chunk study is asked for, and what of it is possible."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from downbeat.perception.features import F32
from downbeat.tools.conditions import Degradation, degradations
from downbeat.tools.console import say, some
from downbeat.tools.errors import ToolError

PAPER_CONDITIONS = ("clean", "robot")
MOST_NAMED = 5


@dataclass(frozen=True)
class ChunkOptions:
    """What to evaluate.

    Attributes:
        tracks: Folder of recordings; None: the bundled pieces, with their own timed rules.
        speech: Folder of voices, for babble and as strangers.
        other: Folder of other sounds, strangers.
        groups: Tab-separated file (track, group): same composer or same sample bank.
        per_shift: Clean chunks per track and shift.
        per_condition: Chunks per track and condition.
        seed: Of all noise.
        only: Conditions; empty: all.
        is_paper: The paper's experiment instead: policies by section.
        clips: Clips of 10 s per track for the listener itself; 0: none.
        foreign_s: Foreign music, and as much speech and noise, for the listener [s].
    """

    tracks: Path | None = None
    speech: Path | None = None
    other: Path | None = None
    groups: Path | None = None
    per_shift: int = 6
    per_condition: int = 6
    seed: int = 7
    only: tuple[str, ...] = ()
    is_paper: bool = False
    clips: int = 0
    foreign_s: float = 0.0

    def check(self) -> None:
        """Refuse numbers and conditions that cannot be asked for.

        Raises:
            ToolError: A count below 0, an unknown condition, one that needs voices, or none that
                the paper's experiment asks in.
        """
        for name in ("per_shift", "per_condition", "clips", "foreign_s"):
            if getattr(self, name) < 0:
                what = "--foreign-minutes" if name == "foreign_s" else f"--{name.replace('_', '-')}"
                raise ToolError(f"{what} is below 0; valid are 0 (none) and more.")
        silent = [d.name for d in degradations(None)]
        voiced = [d.name for d in degradations(np.ones(1, np.float32)) if d.name not in silent]
        for name in self.only:
            if name not in (*silent, *voiced):
                raise ToolError(
                    f"Condition {name!r} does not exist; valid are {', '.join(silent)}, and with "
                    f"voices (--speech FOLDER) {', '.join(voiced)}."
                )
            if name in voiced and self.speech is None:
                raise ToolError(
                    f"Condition {name!r} is made of voices; name a folder of them "
                    f"(--speech FOLDER). Without: {', '.join(silent)}."
                )
        if self.is_paper and self.only and not set(self.only) & set(PAPER_CONDITIONS):
            raise ToolError(
                f"The paper's experiment is made in {' and '.join(PAPER_CONDITIONS)}, and --only "
                f"names {', '.join(self.only)}."
            )

    def degradations(self, babble: F32 | None) -> Sequence[Degradation]:
        """Return the conditions that were asked for; without voices, those that need none."""
        found = degradations(babble)
        return [d for d in found if d.name in self.only] if self.only else found


def check_groups(groups: Mapping[str, str], names: Collection[str], path: Path) -> None:
    """Say which rows of a file of groups name no recording, and how many recordings no row names.

    Raises:
        ToolError: No row names a recording.
    """
    unknown = [name for name in groups if name not in names]
    if len(unknown) == len(groups):
        example = f"such as {sorted(names)[0]!r}"
        raise ToolError(
            f"{path} names none of the {len(names)} recordings (it has "
            f"{some([repr(name) for name in unknown], MOST_NAMED, ', ') or 'no row'}); valid are "
            f"file names without their suffix, {example}."
        )
    if unknown:
        named = some(unknown, MOST_NAMED, ", ")
        say(f"{path}: {len(unknown)} of {len(groups)} names match no recording: {named}")
    if without := [name for name in names if name not in groups]:
        named = some(without, MOST_NAMED, ", ")
        say(f"{path}: {len(without)} of {len(names)} recordings are in no group: {named}")
