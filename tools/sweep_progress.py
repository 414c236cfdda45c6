"""How far a sweep is: a bar in a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.progress import Progress as Bar

from downbeat.sim.batch.sweep import Progress

LINE_EVERY_S = 10.0


class SweepProgress:
    """Told after every unit; counts only pairs that took rollouts into the time left.

    What an earlier run has done is over in milliseconds and says nothing about the rest.
    """

    def __init__(self, pairs: int, to_stderr: bool = False) -> None:
        """Prepare.

        Args:
            pairs: In all.
            to_stderr: Standard output belongs to a JSON object.
        """
        self._pairs = pairs
        self._console = Console(stderr=to_stderr, markup=False, highlight=False)
        self._bar: Bar | None = None
        self._task: Any = None
        self._before = Progress(0, pairs, 0, 0.0)
        self._idle_pairs = 0
        self._said_s = -LINE_EVERY_S

    def __enter__(self) -> SweepProgress:
        if self._console.is_terminal:
            self._bar = Bar(
                TextColumn("pairs"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[note]}"),
                console=self._console,
            )
            self._bar.start()
            self._task = self._bar.add_task("", total=self._pairs, note="")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, progress: Progress) -> None:
        """Show it."""
        if progress.rollouts == self._before.rollouts:
            self._idle_pairs += progress.pairs_done - self._before.pairs_done
        self._before = progress
        note = f"{progress.rollouts:,} rollouts, {self.left(progress)}"
        if self._bar is not None:
            self._bar.update(self._task, completed=progress.pairs_done, note=note)
            return
        is_last = progress.pairs_done >= progress.pairs
        if is_last or progress.seconds - self._said_s >= LINE_EVERY_S:
            self._said_s = progress.seconds
            clock = time.strftime("%H:%M:%S")
            self._console.print(
                f"{clock} {progress.pairs_done} of {progress.pairs} pairs, {note}", soft_wrap=True
            )
            (sys.stderr if self._console.stderr else sys.stdout).flush()

    def left(self, progress: Progress) -> str:
        """Return the time left in words."""
        rest = progress.pairs - progress.pairs_done
        fresh = progress.pairs_done - self._idle_pairs
        if rest <= 0:
            return f"done in {words(progress.seconds)}"
        if fresh <= 0:
            return "already known so far"
        return f"{words(progress.seconds / fresh * rest)} left"


def words(seconds: float) -> str:
    """Return a duration as people say it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min"
