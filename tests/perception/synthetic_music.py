"""Small deterministic pieces of music for tests without recordings."""

import numpy as np

RATE = 22_050


def make_music(seed: int, seconds: float, rate: int = RATE) -> np.ndarray:
    """Return chords, a melody and drums drawn from a seed; no two bars are alike."""
    rng = np.random.default_rng(seed)
    out = np.zeros(round(seconds * rate))
    beat_s = 60.0 / rng.uniform(90, 140)
    scale = rng.permutation(np.arange(45, 80))[:14]
    for beat in range(int(seconds / beat_s)):
        start = round(beat * beat_s * rate)
        t = np.arange(round(beat_s * rate)) / rate
        note = np.zeros(len(t))
        for pitch in rng.choice(scale, 3, replace=False):
            hertz = 440.0 * 2 ** ((pitch - 69) / 12)
            for harmonic in range(1, 7):
                note += np.sin(2 * np.pi * hertz * harmonic * t) / harmonic * np.exp(-t * 3)
        note += rng.standard_normal(len(t)) * np.exp(-t * 60) * 0.5
        stop = min(start + len(t), len(out))
        out[start:stop] += note[: stop - start]
    return (0.2 * out / (np.abs(out).max() + 1e-9)).astype(np.float32)


def make_song(seed: int, verse_s: float) -> np.ndarray:
    """Return verse, bridge, the same verse bit for bit, ending; each of `verse_s`."""
    verse, bridge, ending = (make_music(seed + part, verse_s) for part in (0, 100, 200))
    return np.concatenate([verse, bridge, verse, ending])
