"""A microphone on this machine as a source (PortAudio).

PortAudio calls back in a thread of its own; it only copies the samples and notes the time. The
listener's loop takes them from a bounded queue, so that nothing ever waits: a deque's append and
popleft are single steps of the interpreter. Opening, closing and looking for the device again are
slow and may hang with a broken one; they too run in a thread of their own.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from collections import deque
from typing import Any

import numpy as np

from downbeat.perception.capture_clock import CaptureClock
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.ring import RATE_HZ, Block, Resampler
from downbeat.perception.sound_devices import InputDevice, find_input, load_portaudio
from downbeat.perception.source import SourceCounters
from downbeat.runtime.clock import Clock

log = logging.getLogger("downbeat.listener")

LATENCY_S = 0.05
"""Asked of the driver: more costs time, less costs samples on a busy machine."""
QUEUE_BLOCKS = 1000
"""Ten seconds of blocks of 10 ms; a loop that stands still for longer has lost the rest."""
OUTAGE_US = 1_000_000
"""After so long without a block the device counts as gone."""
RETRY_US = 1_000_000
MAX_AGE_US = 2_000_000
"""A driver that says that a block is older than this, or from the future, does not know."""


class Capture:
    """One opening of the device: what PortAudio calls back, and what it has brought."""

    def __init__(self, portaudio: Any, device: InputDevice, clock: Clock) -> None:
        """Open and start.

        Raises:
            PerceptionError: The device does not take any format.
        """
        self.device = device
        self.queue: deque[tuple[F32, int, bool]] = deque()
        """(samples, capture time of the first [us], samples were lost before)."""
        self.num_dropped = 0
        """Blocks that the queue had no room for."""
        self._clock = clock
        self._dropped_before = self._is_closed = False
        self._stream, self.sample_rate_hz = self._open(portaudio)
        self._period_us = 1e6 / self.sample_rate_hz
        self._stream.start()

    def _open(self, portaudio: Any) -> tuple[Any, int]:
        """Ask for 16 kHz mono first, then for what the device likes."""
        device = self.device
        own_hz = round(device.sample_rate_hz)
        reasons = []
        for rate in dict.fromkeys((RATE_HZ, own_hz)):
            for channels in dict.fromkeys((1, device.channels)):
                try:
                    stream = portaudio.InputStream(
                        samplerate=rate,
                        device=device.number,
                        channels=channels,
                        dtype="float32",
                        latency=LATENCY_S,
                        callback=self._take,
                    )
                    return stream, rate
                except (portaudio.PortAudioError, ValueError, OSError) as error:
                    reasons.append(str(error))
        raise PerceptionError(
            f'Microphone "{device.name}" cannot be opened at {RATE_HZ} or {own_hz} Hz: '
            f"{reasons[0]}; close the program that uses it, or name another device."
        )

    def _take(self, samples: F32, frames: int, time: Any, status: Any) -> None:
        """Note a block; called by PortAudio's thread, which nothing may hold up."""
        now = self._clock.utime()
        if len(self.queue) >= QUEUE_BLOCKS:
            self.num_dropped += 1
            self._dropped_before = True
            return
        # Both read now: what this thread waited for the interpreter cancels out.
        age_us = (self._stream.time - time.inputBufferAdcTime) * 1e6
        if time.inputBufferAdcTime <= 0.0 or not 0.0 <= age_us <= MAX_AGE_US:
            age_us = frames * self._period_us
        lost = bool(status.input_overflow) or self._dropped_before
        self._dropped_before = False
        with np.errstate(all="ignore"):  # a driver may hand over anything; it is judged later
            mono = samples.mean(axis=1, dtype=np.float32)  # a copy: the buffer is PortAudio's
        self.queue.append((mono, now - round(age_us), lost))

    @property
    def is_active(self) -> bool:
        """Whether the driver still believes in it."""
        try:
            return bool(self._stream.active)
        except Exception:  # a device that is gone may answer with anything
            return False

    def close(self) -> None:
        """Release the device, once; a broken one may refuse."""
        if self._is_closed:  # after PortAudio has started anew the old handle points nowhere
            return
        self._is_closed = True
        try:
            self._stream.abort(ignore_errors=True)
            self._stream.close(ignore_errors=True)
        except Exception as error:
            log.debug('microphone "%s" does not close: %s', self.device.name, error)


class Microphone:
    """A `perception.source.Source` that survives its device."""

    sample_rate_hz = RATE_HZ
    duration_s = math.nan
    is_finished = False

    def __init__(
        self,
        clock: Clock,
        device: str = "",
        first_sample_utime: int = 0,
        latency_s: float = 0.0,
        portaudio: Any = None,
    ) -> None:
        """Open it.

        Args:
            clock: The show's.
            device: Its name, part of it, or its number; "" for the default one.
            first_sample_utime: What came before is not heard [us].
            latency_s: From sound to the driver's own stamp [s]; to be calibrated.
            portaudio: The module sounddevice; omitted: imported.

        Raises:
            PerceptionError: No PortAudio, no such device, or it cannot be opened.
        """
        self._clock = clock
        self._wanted = device
        self._portaudio = portaudio or load_portaudio()
        self._latency_us = round(latency_s * 1e6)
        self.first_sample_utime = first_sample_utime
        self.counters = SourceCounters()
        self.failure = ""
        self._heard_utime = max(clock.utime(), first_sample_utime)
        self._last_came = self._heard_utime
        self._next_try = 0
        self._worker: threading.Thread | None = None
        self._reopened: Capture | None = None
        self._begin(Capture(self._portaudio, find_input(self._portaudio, device), clock))
        self.name = f"microphone {self._capture.device.name}"

    def _begin(self, capture: Capture) -> None:
        self._capture = capture
        self._stamps = CaptureClock(capture.sample_rate_hz)
        self._resampler = Resampler(capture.sample_rate_hz)
        self._counted_bad = self._counted_lost = 0

    @property
    def heard_utime(self) -> int:
        """When the last sample that was read had sounded; during an outage: the last read [us]."""
        return self._heard_utime

    def read(self, utime: int) -> list[Block]:
        """Return what came in since the last read; see `Source.read`."""
        if self.failure:
            self._heard_utime = utime
            self._try_again(utime)
            if self.failure:
                return []
        blocks: list[Block] = []
        queue = self._capture.queue
        for _ in range(len(queue)):
            samples, captured, lost = queue.popleft()
            self._last_came = utime
            captured -= self._latency_us
            if captured >= self.first_sample_utime:
                blocks += self._hear(samples, captured, lost)
        silent_us = utime - self._last_came
        if silent_us > OUTAGE_US or not self._capture.is_active:
            self._lose(utime)
        return blocks

    def _hear(self, samples: F32, captured: int, lost: bool) -> list[Block]:
        counters = self.counters
        counters.good += 1
        counters.xruns += lost
        start, follows = self._stamps.place(len(samples), captured, lost)
        blocks = self._resampler.push(Block(samples, start, follows))
        counters.bad_samples += self._resampler.num_bad_samples - self._counted_bad
        self._counted_bad = self._resampler.num_bad_samples
        missing = round(self._stamps.num_lost * RATE_HZ / self._capture.sample_rate_hz)
        counters.lost_samples += missing - self._counted_lost
        self._counted_lost = missing
        self._heard_utime = start + len(samples) * 1_000_000 // self._capture.sample_rate_hz
        return blocks

    def _lose(self, utime: int) -> None:
        """The device is gone: say so once, and look for it every second."""
        self.counters.outages += 1
        self.failure = (
            f"The {self.name} is gone; it is looked for every {RETRY_US / 1e6:.0f} s and heard "
            "again when it is back."
        )
        self._next_try = utime
        self._try_again(utime)

    def _try_again(self, utime: int) -> None:
        """Take what the worker has found, or send it out when it is time."""
        if self._worker is not None and not self._worker.is_alive():
            self._worker = None
            found, self._reopened = self._reopened, None
            if found is not None:
                self._begin(found)
                self._last_came = utime
                self.failure = ""
                return
        if self._worker is None and utime >= self._next_try:
            self._next_try = utime + RETRY_US
            self._worker = threading.Thread(target=self._reopen, name="microphone", daemon=True)
            self._worker.start()

    def _reopen(self) -> None:
        """Close what is left, let PortAudio look at the devices anew, open (worker thread)."""
        portaudio = self._portaudio
        self._capture.close()
        try:
            # PortAudio lists devices when it starts and at no other time.
            with contextlib.suppress(Exception):
                portaudio._terminate()
            portaudio._initialize()
            device = find_input(portaudio, self._wanted)
            self._reopened = Capture(portaudio, device, self._clock)
        except Exception as error:  # whatever it is, it is tried again
            log.debug("%s: %s", self.name, error)

    def close(self) -> None:
        """Release the device."""
        if self._worker is not None:
            self._worker.join(timeout=1.0)
        for capture in (self._capture, self._reopened):
            if capture is not None:
                capture.close()
