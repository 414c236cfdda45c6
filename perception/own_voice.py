"""The robot's own voice is no command: what sounds like what is being played is not listened to.

While the robot speaks, its microphones hear it. A segment whose loudness in bands rises and falls
as the playback does is its own voice, whatever the room did to it; one that does not is somebody
who speaks into it.
"""

from __future__ import annotations

from collections import deque

import numpy as np
import numpy.typing as npt

from downbeat.perception.features import F32

RATE_HZ = 16_000
HOP = 160
"""10 ms, like the step of a spectrum in speech recognition."""
WINDOW = 512
BANDS = 16
LIKE = 0.6
"""Correlation of the loudness in bands from which a segment is the robot's own."""
MAX_DELAY_S = 0.6
"""From the playback's stamp to the microphone's: sound card, air, robot's microphone stream."""
TAIL_US = 300_000
KEPT_US = 60_000_000


class OwnVoice:
    """Remembers what is played, and recognises it."""

    def __init__(self) -> None:
        self._played: deque[tuple[int, F32]] = deque()

    def play(self, samples: npt.NDArray[np.int16], utime: int) -> None:
        """Note that (n,) samples at 16 kHz begin to sound at `utime` [us]."""
        self._played.append((utime, samples.astype(np.float32) / 32768.0))
        while self._played and utime - self._played[0][0] > KEPT_US:
            self._played.popleft()

    def stop(self, utime: int) -> None:
        """Note that the playback was cut at `utime` [us]."""
        if self._played:
            begin, samples = self._played[-1]
            self._played[-1] = (begin, samples[: max(0, (utime - begin) * RATE_HZ // 1_000_000)])

    def is_near(self, start_utime: int, end_utime: int) -> bool:
        """Whether something was played during a segment, or just before."""
        return any(
            start_utime < begin + round(len(samples) / RATE_HZ * 1e6) + TAIL_US
            and end_utime > begin
            for begin, samples in self._played
        )

    def likeness(self, samples: F32, start_utime: int) -> float:
        """Return the correlation of a segment with what was played then, at the best delay.

        Args:
            samples: (n,) at 16 kHz, as heard.
            start_utime: When samples[0] sounded [us].
        """
        heard = _loudness(samples)
        best = 0.0
        if len(heard) < 10:
            return best
        for begin, played in self._played:
            line = _loudness(played)
            first = round((start_utime - begin) * 1e-6 * RATE_HZ / HOP)
            for delay in range(-5, round(MAX_DELAY_S * RATE_HZ / HOP), 2):
                at = first - delay
                low, high = max(at, 0), min(at + len(heard), len(line))
                if high - low < max(10, len(heard) // 3):
                    continue
                best = max(best, _correlation(heard[low - at : high - at], line[low:high]))
        return best

    def is_own(self, samples: F32, start_utime: int, end_utime: int) -> bool:
        """Whether a segment is the robot's own voice."""
        near = self.is_near(start_utime, end_utime)
        return near and self.likeness(samples, start_utime) >= LIKE


def _loudness(samples: F32) -> npt.NDArray[np.float32]:
    """Return (frames, BANDS) log energy; bands are spaced as hearing is."""
    count = max(0, (len(samples) - WINDOW) // HOP + 1)
    if not count:
        return np.zeros((0, BANDS), np.float32)
    frames = np.lib.stride_tricks.sliding_window_view(samples, WINDOW)[::HOP][:count]
    power = np.abs(np.fft.rfft(frames * np.hanning(WINDOW).astype(np.float32), axis=1)) ** 2
    mel = np.linspace(0.0, 1.0, BANDS + 1)
    edges = np.round(4 + (WINDOW // 4) * (10.0**mel - 1.0) / 9.0).astype(int)
    energy = np.stack(
        [power[:, a : max(b, a + 1)].sum(1) for a, b in zip(edges, edges[1:])], axis=1
    )
    return np.log(energy + 1e-4).astype(np.float32)


def _correlation(a: npt.NDArray[np.float32], b: npt.NDArray[np.float32]) -> float:
    """Return how alike two spectrograms change in time, a room's colour taken out."""
    a, b = a - a.mean(0), b - b.mean(0)
    scale = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / scale if scale > 0.0 else 0.0
