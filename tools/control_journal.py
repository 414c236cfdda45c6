"""The journal of a run: one record per control tick."""

from __future__ import annotations

from pathlib import Path

from downbeat.control.core import ControlCore, TickInput, TickOutput
from downbeat.control.record import tick_record
from downbeat.runtime.config import plain
from downbeat.runtime.journal import JournalWriter
from downbeat.tools.show import Show

JOURNAL_NAME = "journal"


class ControlJournal:
    """Writes the journal; records hold the show's time only: equal runs are equal bytes."""

    def __init__(self, path: Path, show: Show, core: ControlCore) -> None:
        """Create the file; its header says which policies and settings a replay needs.

        Raises:
            JournalError: The file cannot be written.
        """
        library = core.library
        self._writer = JournalWriter(
            path,
            {
                "show": plain(show.config),
                "core": plain(core.config),
                "policies": {name: library[name].manifest.sha256 for name in library.names},
            },
        )

    def record(self, inputs: TickInput, output: TickOutput) -> None:
        """Append one tick."""
        self._writer.write(tick_record(inputs, output))

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()
