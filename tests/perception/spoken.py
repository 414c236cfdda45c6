"""Speech for the tests: espeak-ng voices, cached, in noise that is never digital silence."""

from __future__ import annotations

import functools
import io
import shutil
import subprocess

import numpy as np
import pytest
import soundfile
import soxr

RATE = 16_000
needs_espeak = pytest.mark.skipif(
    shutil.which("espeak-ng") is None, reason="espeak-ng is not installed"
)


@functools.lru_cache(maxsize=512)
def _say(text: str, voice: str, words_per_minute: int) -> np.ndarray:
    command = ["espeak-ng", "-v", voice, "-s", str(words_per_minute), "--stdout", text]
    raw = subprocess.run(command, capture_output=True, check=True, timeout=30).stdout
    samples, rate = soundfile.read(io.BytesIO(raw), dtype="float32")
    return soxr.resample(samples, rate, RATE).astype(np.float32)


def say(text, voice="en-us", words_per_minute=160):
    """Return (n,) speech at 16 kHz, RMS 0.05 while it sounds."""
    samples = _say(text, voice, words_per_minute)
    return samples * np.float32(0.05 / np.sqrt(np.mean(samples**2)))


def in_noise(samples, snr_db=20.0, before_s=0.5, after_s=0.5, seed=1):
    """Return the samples with noise around and over them; `snr_db` is over the whole speech."""
    padded = np.pad(samples, (round(before_s * RATE), round(after_s * RATE)))
    level = np.sqrt(np.mean(samples**2)) * 10 ** (-snr_db / 20)
    noise = np.random.default_rng(seed).standard_normal(len(padded))
    return (padded + level * noise).astype(np.float32)
