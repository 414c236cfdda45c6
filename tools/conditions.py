"""What is done to music before it is asked for: the conditions of the chunk study, by name.

Rooms, noise and microphone are those of matcher_sounds.py; here are codecs, bands, levels, and what
changes the time of the music. All are deterministic by the generator handed in. Nothing but
libsndfile and libsoxr is needed: tempo is changed by overlap-add of the best fitting pieces.
"""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
import soundfile
import soxr
from scipy.signal import butter, fftconvolve, sosfilt

from downbeat.perception.features import F32
from downbeat.tools.matcher_sounds import (
    Condition,
    add_noise,
    pink_noise,
    robot_microphone,
    room,
    white_noise,
)

MP3_32K = ("MP3", "MPEG_LAYER_III", 0.9999, "AVERAGE")
OPUS_32K = ("OGG", "OPUS", 0.896, None)
"""libsndfile names a bit rate by a level: MP3 320..32, Opus 256..6 kbit/s over 0..1. An MP3 of
constant rate would carry no length of its padding, and come back 42 ms late."""
OPUS_RATE_HZ = 48_000
TELEPHONE_HZ = (300.0, 3400.0)
PIECE_S, SEEK_S = 0.08, 0.012
"""Time stretching: pieces of this length, moved by at most this much to where they fit."""


@dataclass(frozen=True, slots=True)
class Degradation:
    """One condition.

    Attributes:
        name: As in tables.
        apply: (samples, sample rate, generator) -> samples, perhaps of another length.
        time_factor: Seconds of the original per second of the result.
        is_negative_too: Sound that must be refused is heard in this condition as well.
    """

    name: str
    apply: Condition
    time_factor: float = 1.0
    is_negative_too: bool = False


def degradations(babble: F32 | None) -> list[Degradation]:
    """Return the conditions of the protocol.

    Args:
        babble: Voices at the rate of the sound; None: conditions that need them are left out.
    """
    found = [
        Degradation("clean", lambda x, _rate, _rng: x, is_negative_too=True),
        Degradation("vol-20dB", lambda x, _rate, _rng: x * np.float32(0.1)),
        Degradation("mp3_32k", codec(*MP3_32K), is_negative_too=True),
        Degradation("opus_32k", codec(*OPUS_32K)),
        Degradation("band300_3400", band(*TELEPHONE_HZ)),
        Degradation("reverb0.5", reverb(0.5, 3.0)),
        Degradation("reverb1.0", reverb(1.0, -3.0)),
        Degradation("white10", white_noise(10.0)),
        Degradation("white5", white_noise(5.0)),
        Degradation("white0", white_noise(0.0), is_negative_too=True),
        Degradation("pink0", pink(0.0)),
    ]
    for percent in (-4, -2, 2, 4):
        factor = 1.0 + percent / 100.0
        found += [
            Degradation(f"tempo{percent:+d}%", tempo(factor), factor),
            Degradation(f"pitch{percent:+d}%", pitch(factor)),
            Degradation(f"speed{percent:+d}%", speed(factor), factor),
        ]
    if babble is not None:
        found += [
            Degradation("babble10", voices(babble, 10.0)),
            Degradation("babble5", voices(babble, 5.0), is_negative_too=True),
            Degradation("babble0", voices(babble, 0.0)),
            Degradation("robot", _robot(babble), is_negative_too=True),
        ]
    return found


def codec(container: str, subtype: str, level: float, mode: str | None) -> Condition:
    """Return "encoded and decoded again"."""

    def apply(samples: F32, sample_rate_hz: int, _rng: np.random.Generator) -> F32:
        rate = OPUS_RATE_HZ if subtype == "OPUS" else sample_rate_hz
        sound = soxr.resample(samples, sample_rate_hz, rate)
        file = io.BytesIO()
        with soundfile.SoundFile(
            file, "w", rate, 1, subtype, format=container, compression_level=level,
            bitrate_mode=mode,
        ) as out:  # fmt: skip
            out.write(np.clip(sound, -1.0, 1.0))
        file.seek(0)
        decoded, _ = soundfile.read(file, dtype="float32")
        return _fit(soxr.resample(decoded, rate, sample_rate_hz), len(samples))

    return apply


def band(low_hz: float, high_hz: float) -> Condition:
    """Return "through a band"."""

    def apply(samples: F32, sample_rate_hz: int, _rng: np.random.Generator) -> F32:
        edges = (low_hz, min(high_hz, 0.49 * sample_rate_hz))
        sos = butter(4, edges, "bandpass", fs=sample_rate_hz, output="sos")
        return np.asarray(sosfilt(sos, samples), np.float32)

    return apply


def reverb(rt60_s: float, direct_db: float) -> Condition:
    """Return "in a room"; `direct_db`: direct to diffuse sound."""

    def apply(samples: F32, sample_rate_hz: int, rng: np.random.Generator) -> F32:
        response = room(rt60_s, sample_rate_hz, rng, direct_db)
        return np.asarray(fftconvolve(samples, response)[: len(samples)], np.float32)

    return apply


def pink(snr_db: float) -> Condition:
    """Return "pink noise at this ratio"."""
    return lambda x, rate, rng: add_noise(x, pink_noise(len(x), rng), snr_db, rate)


def voices(babble: F32, snr_db: float) -> Condition:
    """Return "people talking at this ratio"."""

    def apply(samples: F32, sample_rate_hz: int, rng: np.random.Generator) -> F32:
        noise = np.resize(np.roll(babble, -int(rng.integers(len(babble)))), len(samples))
        return add_noise(samples, noise, snr_db, sample_rate_hz)

    return apply


def speed(factor: float) -> Condition:
    """Return "played faster": time and pitch."""
    return lambda x, rate, _rng: np.asarray(
        soxr.resample(x, rate * factor, float(rate)), np.float32
    )


def tempo(factor: float) -> Condition:
    """Return "played faster, at the same pitch"."""
    return lambda x, rate, _rng: stretch(x, 1.0 / factor, rate)


def pitch(factor: float) -> Condition:
    """Return "played higher, at the same tempo"."""

    def apply(samples: F32, sample_rate_hz: int, rng: np.random.Generator) -> F32:
        longer = stretch(samples, factor, sample_rate_hz)
        return _fit(speed(factor)(longer, sample_rate_hz, rng), len(samples))

    return apply


def stretch(samples: F32, factor: float, sample_rate_hz: int) -> F32:
    """Make a sound longer at the same pitch (waveform-similarity overlap-add).

    Args:
        samples: (n,).
        factor: Length of the result over the original's.
        sample_rate_hz: [Hz].

    Returns:
        (round(factor n),).
    """
    hop = round(PIECE_S * sample_rate_hz) // 2
    seek = round(SEEK_S * sample_rate_hz)
    window = np.hanning(2 * hop + 1)[:-1].astype(np.float32)
    count = round(len(samples) * factor)
    source = np.pad(samples, (seek + hop, 3 * hop + 2 * seek))
    out = np.zeros(count + 4 * hop, np.float32)
    shift = before = 0
    for number in range(count // hop + 2):
        # Where this piece should come from, and where the last one would have gone on.
        want = round((number - 1) * hop / factor) + seek + hop
        if number:
            onward = source[before + hop : before + 2 * hop]
            near = source[want - seek : want + seek + hop]
            if len(onward) < hop or len(near) < 2 * seek + hop:
                break
            shift = int(fftconvolve(near, onward[::-1], "valid").argmax()) - seek
        before = want + shift
        piece = source[before : before + 2 * hop]
        if len(piece) < 2 * hop:
            break
        out[number * hop : number * hop + 2 * hop] += piece * window
    return out[hop : hop + count]


def _robot(babble: F32) -> Condition:
    heard = robot_microphone(babble)
    opus = codec(*OPUS_32K)
    return lambda x, rate, rng: opus(heard(x, rate, rng), rate, rng)


def _fit(samples: F32, count: int) -> F32:
    return np.asarray(np.pad(samples, (0, max(0, count - len(samples))))[:count], np.float32)
