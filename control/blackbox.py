"""The black box: the last seconds of the bus and of control's ticks, written when the robot trips.

Notes are kept in memory. After a trip they are written a few per tick: a dump of thousands of
messages in one go would cost the very ticks that follow an accident.
"""

from __future__ import annotations

import json
import logging
from collections import deque
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from downbeat.control.core import TickInput, TickOutput
from downbeat.control.record import tick_record
from downbeat.runtime.clock import Clock
from downbeat.runtime.log import LogWriter

logger = logging.getLogger("downbeat.control")

KEPT_US = 10_000_000
KEPT_TICKS = 500
WRITTEN_PER_TICK = 40
"""Messages; about 1 ms of a tick's 20."""
MAX_DUMPS = 16
"""A robot that trips again and again must not fill the disk."""


class BlackBox:
    """Keeps and dumps; give `note` to the endpoint as its tap."""

    def __init__(self, folder: Path, clock: Clock) -> None:
        """Prepare; nothing is written before a trip.

        Args:
            folder: Receives one folder per trip, named by its time [us].
            clock: The show's.
        """
        self._folder = folder
        self._clock = clock
        self._messages: deque[tuple[int, str, bytes]] = deque()
        self._ticks: deque[tuple[TickInput, TickOutput]] = deque(maxlen=KEPT_TICKS)
        self._writer: Iterator[None] | None = None
        self.dumps = 0

    def note(self, channel: str, payload: bytes) -> None:
        """Keep one message of the bus, in or out."""
        self._messages.append((self._clock.utime(), channel, payload))

    def after_tick(self, inputs: TickInput, output: TickOutput) -> None:
        """Keep one tick; start a dump if it tripped, go on with one that is under way."""
        self._ticks.append((inputs, output))
        messages, oldest = self._messages, inputs.utime - KEPT_US
        while messages and messages[0][0] < oldest:
            messages.popleft()
        if output.tripped and self._writer is None and self.dumps < MAX_DUMPS:
            self.dumps += 1
            self._writer = self._dump(self._folder / str(inputs.utime), output.status.fault_text)
        if self._writer is not None and next(self._writer, True):
            self._writer = None

    def close(self) -> None:
        """Finish a dump that is under way."""
        if self._writer is not None:
            for _ in self._writer:
                pass
            self._writer = None

    def _dump(self, folder: Path, reason: str) -> Iterator[None]:
        messages, ticks = list(self._messages), list(self._ticks)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            log = LogWriter(folder / "bus.lcmlog")
            yield
            pending = iter(messages)
            while batch := list(islice(pending, WRITTEN_PER_TICK)):
                for utime, channel, payload in batch:
                    log.write(utime, channel, payload)
                yield
            log.close()
            with (folder / "ticks.jsonl").open("w", encoding="utf-8") as file:
                file.write(json.dumps({"trip": reason}) + "\n")
                for inputs, output in ticks:
                    file.write(json.dumps(tick_record(inputs, output)) + "\n")
                    yield
        except OSError as error:
            logger.error("the black box cannot write %s: %s", folder, error)
            return
        logger.warning("black box written: %s (%s)", folder, reason)
