"""Writes H.264 with AAC sound."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

AUDIO_RATE_HZ = 44_100
AUDIO_BLOCK = 1024


class VideoWriter:
    """An MP4 file that grows frame by frame; players can begin before it has loaded."""

    def __init__(
        self, path: Path, size_px: tuple[int, int], fps: int, audio: NDArray[np.float32] | None
    ) -> None:
        """Open the file.

        Args:
            path: To write.
            size_px: Width and height, both even.
            fps: Frames per second.
            audio: (n,) mono at 44.1 kHz from the first frame on; None: silent.
        """
        self._container: Any = av.open(str(path), "w", options={"movflags": "faststart"})
        self._video: Any = self._container.add_stream("h264", rate=fps)
        self._video.width, self._video.height = size_px
        self._video.pix_fmt = "yuv420p"
        self._video.options = {"crf": "21", "preset": "veryfast"}
        self._fps = fps
        self._frames = 0
        self._samples = audio
        self._sent = 0
        self._audio: Any = None
        if audio is not None:
            self._audio = self._container.add_stream("aac", rate=AUDIO_RATE_HZ)
            self._audio.layout = "mono"

    def __enter__(self) -> VideoWriter:
        """Return the open writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the file."""
        self.close()

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Append one frame, (height, width, 3), and the sound that belongs to it."""
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
        frame.pts = self._frames
        frame.time_base = Fraction(1, self._fps)
        self._container.mux(self._video.encode(frame))
        self._frames += 1
        self._add_audio(until=self._frames * AUDIO_RATE_HZ // self._fps)

    def _add_audio(self, until: int) -> None:
        if self._audio is None or self._samples is None:
            return
        while self._sent < min(until, self._samples.size):
            block = self._samples[self._sent : self._sent + AUDIO_BLOCK]
            frame = av.AudioFrame.from_ndarray(
                np.ascontiguousarray(block[None, :]), format="fltp", layout="mono"
            )
            frame.sample_rate = AUDIO_RATE_HZ
            frame.pts = self._sent
            frame.time_base = Fraction(1, AUDIO_RATE_HZ)
            self._container.mux(self._audio.encode(frame))
            self._sent += block.size

    def close(self) -> None:
        """Flush the encoders and close the file."""
        self._container.mux(self._video.encode(None))
        if self._audio is not None:
            self._container.mux(self._audio.encode(None))
        self._container.close()


def load_audio(path: Path, start_s: float, end_s: float) -> NDArray[np.float32]:
    """Return a sound file as mono 44.1 kHz from `start_s` to `end_s`; silence outside it, (n,)."""
    import soundfile
    import soxr

    samples, rate_hz = soundfile.read(str(path), dtype="float32", always_2d=True)
    mono = soxr.resample(samples.mean(axis=1), rate_hz, AUDIO_RATE_HZ)
    first, last = round(start_s * AUDIO_RATE_HZ), round(end_s * AUDIO_RATE_HZ)
    result = np.zeros(last - first, np.float32)
    lead = max(0, -first)
    part = mono[max(0, first) : max(0, last)]
    result[lead : lead + part.size] = part[: result.size - lead]
    return result


def band_levels(samples: NDArray[np.float32], fps: int, bands: int) -> NDArray[np.float64]:
    """Return how loud each band is in every frame, (frames, bands), 0..1, loudest second at 1.

    Bands are even on a logarithmic scale from 60 Hz to 8 kHz; they rise at once and fall slowly.
    """
    window = 2048
    hop = AUDIO_RATE_HZ // fps
    count = samples.size // hop
    padded = np.pad(samples, (window // 2, window))
    edges = np.geomspace(60.0, 8_000.0, bands + 1) * window / AUDIO_RATE_HZ
    bins = np.maximum(np.round(edges).astype(int), 1)
    shape = np.hanning(window)
    levels = np.zeros((count, bands))
    for k in range(count):
        spectrum = np.abs(np.fft.rfft(padded[k * hop : k * hop + window] * shape))
        for band in range(bands):
            low, high = bins[band], max(bins[band + 1], bins[band] + 1)
            levels[k, band] = spectrum[low:high].mean()
    levels = np.log1p(levels)
    loud = np.percentile(levels, 99.0, axis=0)
    levels = np.clip(levels / np.maximum(loud, 1e-6), 0.0, 1.0) ** 1.8
    for k in range(1, count):
        levels[k] = np.maximum(levels[k], levels[k - 1] * 0.86)
    return levels
