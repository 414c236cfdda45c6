"""What control writes per tick: which messages it consumed, and hashes of what it computed."""

from __future__ import annotations

from pathlib import Path

from downbeat.control.core import TickInput, TickOutput
from downbeat.runtime.config import plain
from downbeat.runtime.journal import JournalWriter
from downbeat.tools.show import Show


class ControlJournal:
    """The journal of a run; records hold the show's time only: equal runs are equal bytes."""

    def __init__(self, path: Path, show: Show) -> None:
        self._writer = JournalWriter(path, plain(show.config))

    def record(self, inputs: TickInput, output: TickOutput) -> None:
        """Append one tick."""
        status = output.status
        self._writer.write(
            {
                "tick": inputs.tick,
                "utime": inputs.utime,
                "state_seq": None if inputs.state is None else inputs.state.header.seq,
                "requests": [(m.header.epoch, m.header.seq) for m in inputs.requests],
                "operator": [(m.header.epoch, m.header.seq) for m in inputs.operator],
                "estops": [(m.header.epoch, m.header.seq) for m in inputs.estops],
                "mode": status.mode,
                "skill": status.skill,
                "input": status.input_hash,
                "obs": status.obs_hash,
                "action": status.action_hash,
                "command": status.command_hash,
            }
        )

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()
