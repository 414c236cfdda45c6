"""Train the embedded router on audio that this script makes, or is pointed at.

python -m downbeat.tools.train_router [--songs DIR] [--music DIR] [--speech DIR] [--other DIR]

The bundled pieces, the voices of espeak-ng (where it is installed) and synthetic noise always take
part. Recordings are split by name: a fifth of the sources is never trained on while the printed
figures are measured; the weights that are written saw all of them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import tyro
from rich.progress import track as progress

from downbeat.perception.features import F32
from downbeat.perception.router import LABEL_NAMES, RouterConfig, route
from downbeat.perception.router_embedded import WEIGHTS, RouterNet
from downbeat.perception.router_features import MIN_FRAMES, window_features
from downbeat.perception.router_frames import FRAME_RATE_HZ, HOP, FrameStream
from downbeat.perception.source import Recording, audio_files, load_recording
from downbeat.perception.vad import FRAME_SAMPLES, Vad, voiced_fraction
from downbeat.tools.composer.store import COMPOSITIONS, composed_recording
from downbeat.tools.router_fit import FitOptions, fit
from downbeat.tools.router_singing import sing
from downbeat.tools.router_sounds import (
    CLIP_S,
    SAMPLE_RATE_HZ,
    Clip,
    active_rms,
    at_rate,
    babble,
    heard,
    noises,
    over_music,
    piece,
    synthetic_voices,
    truth_over_music,
)
from downbeat.tools.rundir import CACHE_DIR

WINDOW_S = 5.0
KEPT_S = 90.0
"""Of every recording: its middle."""
VALIDATED_EVERY = 5
RATIO_DB = (-12.0, 15.0)
SUNG_DB = (-6.0, 10.0)
KIND_SHARES = {
    "song": 0.15,
    "sung": 0.10,
    "music": 0.12,
    "speech": 0.20,
    "speech over music": 0.26,
    "other": 0.10,
    "other on tape": 0.07,
}


@dataclass
class Sounds:
    """What clips are made of, by name, at 16 kHz."""

    songs: dict[str, F32] = field(default_factory=dict)
    music: dict[str, F32] = field(default_factory=dict)
    people: dict[str, F32] = field(default_factory=dict)
    robots: dict[str, F32] = field(default_factory=dict)
    other: dict[str, F32] = field(default_factory=dict)

    def half(self, is_validation: bool) -> Sounds:
        """Return the sources that are kept for validation, or the others."""
        return Sounds(
            **{
                name: {
                    key: sound
                    for n, (key, sound) in enumerate(sorted(sounds.items()))
                    if (n % VALIDATED_EVERY == 1) == is_validation
                }
                for name, sounds in vars(self).items()
            }
        )


@dataclass
class Rows:
    """Windows as numbers.

    Attributes:
        values: (n, NUM_FEATURES).
        truth: (n, 2).
        v_frac: (n,).
        kinds: (n,) what each was made of.
    """

    values: F32
    truth: F32
    v_frac: F32
    kinds: list[str]


@dataclass(frozen=True)
class Train:
    """Train the embedded router."""

    songs: Path | None = None
    """Folder of music with singing: drawn as often as all the other music."""
    music: Path | None = None
    """Folder of music."""
    speech: Path | None = None
    """Folder of voices, one file per voice."""
    other: Path | None = None
    """Folder of sounds that are neither."""
    clips: int = 6000
    """Clips of 7 s to make; three windows are taken of each."""
    seed: int = 1
    """Of everything."""
    out: Path = WEIGHTS
    """The weights file to write."""

    def run(self) -> int:
        """Train, print what the held-apart fifth says, and write the weights."""
        sounds = load_sounds(self)
        vad = Vad()
        train = make_rows(sounds.half(False), round(0.8 * self.clips), self.seed, vad)
        check = make_rows(sounds.half(True), round(0.2 * self.clips), self.seed + 1, vad)
        weights = balance(train)
        print_check(fit(train.values, train.truth, weights, self.seed, FitOptions()), check)
        both = Rows(
            np.concatenate((train.values, check.values)),
            np.concatenate((train.truth, check.truth)),
            np.concatenate((train.v_frac, check.v_frac)),
            train.kinds + check.kinds,
        )
        net = fit(both.values, both.truth, balance(both), self.seed, FitOptions())
        self.out.parent.mkdir(parents=True, exist_ok=True)
        net.save(self.out)
        print(f"{len(both.kinds)} windows; {self.out} has {self.out.stat().st_size / 1000:.0f} kB")
        return 0


def load_sounds(options: Train) -> Sounds:
    """Decode everything.

    Raises:
        PerceptionError: A folder is missing or holds no recording.
    """
    pieces = {
        name: at_rate(composed_recording(name, CACHE_DIR / "tracks")) for name in COMPOSITIONS
    }
    return Sounds(
        songs=_folder(options.songs),
        music={**_folder(options.music), **pieces},
        people=_folder(options.speech),
        robots=synthetic_voices(),
        other=_folder(options.other),
    )


def _folder(folder: Path | None) -> dict[str, F32]:
    found = {}
    for path in progress(audio_files(folder), folder.name, transient=True) if folder else ():
        recording = load_recording(path)
        kept = round(KEPT_S * recording.sample_rate_hz)
        first = max(0, (len(recording.samples) - kept) // 2)
        part = recording.samples[first : first + kept]
        found[path.stem] = at_rate(Recording(path.stem, part, recording.sample_rate_hz))
    return found


def make_rows(sounds: Sounds, count: int, seed: int, vad: Vad) -> Rows:
    """Make clips and measure windows of them."""
    values, truth, v_frac, kinds = [], [], [], []
    rng = np.random.default_rng(seed)
    for _ in progress(range(count), "clips", transient=True):
        clip = make_clip(sounds, rng)
        for numbers, voiced in windows(clip.samples, rng, vad):
            values.append(numbers)
            truth.append((clip.p_music, clip.p_speech))
            v_frac.append(voiced)
            kinds.append(clip.kind)
    return Rows(np.array(values), np.array(truth), np.array(v_frac), kinds)


def windows(samples: F32, rng: np.random.Generator, vad: Vad) -> Iterator[tuple[F32, float]]:
    """Yield (features, voiced fraction) of the first and last 5 s and of a shorter window."""
    frames = FrameStream().push(samples)
    voice = vad.probabilities(samples)
    whole = round(WINDOW_S * FRAME_RATE_HZ)
    short = int(rng.integers(MIN_FRAMES, whole))
    begin = int(rng.integers(0, len(frames) - short))
    spans = ((0, whole), (len(frames) - whole, len(frames)), (begin, begin + short))
    for first, end in spans:
        heard_voice = voice[first * HOP // FRAME_SAMPLES : end * HOP // FRAME_SAMPLES]
        numbers = window_features(frames.part(first, end), heard_voice)
        yield numbers, voiced_fraction(heard_voice)


def make_clip(sounds: Sounds, rng: np.random.Generator) -> Clip:
    """Make one clip of a kind drawn by KIND_SHARES."""
    kind = str(rng.choice(list(KIND_SHARES), p=list(KIND_SHARES.values())))
    voices = sounds.people if sounds.people and rng.random() < 0.75 else sounds.robots
    voices = voices or sounds.people
    songs = sounds.songs if sounds.songs and rng.random() < 0.4 else sounds.music
    if kind.startswith(("speech", "sung")) and not voices:
        kind = "music"
    if kind == "other on tape" and sounds.other:
        name, sound = piece(sounds.other, rng)
        return Clip("other", name, heard(sound, rng), 0.0, 0.0)
    if kind.startswith("other"):
        sound = noises(round(CLIP_S * SAMPLE_RATE_HZ), rng)
        if voices and rng.random() < 0.15:
            sound = babble({**sounds.people, **sounds.robots}, rng) + 0.3 * sound
        return Clip("other", "made", heard(sound, rng), 0.0, 0.0)
    if kind == "speech":
        name, sound = piece(voices, rng)
        return Clip(kind, name, heard(_sparse(sound, rng), rng), 0.0, 1.0)
    if kind == "sung":
        voice, speech = piece(voices, rng)
        sung = sing(speech, rng)
        if rng.random() < 0.85:
            sung = over_music(sung, piece(sounds.music, rng)[1], rng.uniform(*SUNG_DB))
        return Clip(kind, voice, heard(sung, rng), 1.0, 0.0)
    chosen = songs if kind == "speech over music" else sounds.songs if kind == "song" else None
    name, music = piece(chosen or sounds.music, rng)
    if kind == "speech over music":
        voice, speech = piece(voices, rng)
        ratio_db = float(rng.uniform(*RATIO_DB))
        p_music, p_speech = truth_over_music(ratio_db)
        mixed = over_music(speech, music, ratio_db)
        return Clip(kind, f"{voice} {name}", heard(mixed, rng), p_music, p_speech)
    if voices and rng.random() < 0.15:
        gain = active_rms(music) * 10.0 ** (-rng.uniform(0.0, 20.0) / 20.0)
        music = music + np.float32(gain) * babble({**sounds.people, **sounds.robots}, rng)
    return Clip(kind, name, heard(music, rng), 1.0, 0.0)


def _sparse(speech: F32, rng: np.random.Generator) -> F32:
    """Return speech, now and then only a few words of it in a quiet room."""
    if rng.random() < 0.7:
        return speech
    out = np.zeros_like(speech)
    length = int(rng.uniform(0.4, 0.8) * len(speech))
    first = int(rng.integers(len(speech) - length + 1))
    out[first : first + length] = speech[first : first + length]
    hush = active_rms(speech) * 10.0 ** (-rng.uniform(20.0, 45.0) / 20.0)
    return out + np.float32(hush) * noises(len(speech), rng)


def balance(rows: Rows) -> F32:
    """Return weights with which "other" counts twice: its kinds of sound are the most diverse."""
    return np.array([2.0 if kind == "other" else 1.0 for kind in rows.kinds])


def print_check(net: RouterNet, rows: Rows) -> None:
    """Print the labels of the windows that were held apart, by kind."""
    scores = net.scores(rows.values)
    config = RouterConfig()
    labels = [route(m, s, v, config) for (m, s), v in zip(scores.tolist(), rows.v_frac.tolist())]
    for kind in sorted(set(rows.kinds)):
        chosen = [n for n, k in enumerate(rows.kinds) if k == kind]
        shares = [
            f"{name} {np.mean([labels[n] == label for n in chosen]):6.1%}"
            for label, name in LABEL_NAMES.items()
        ]
        error = np.abs(scores[chosen] - rows.truth[chosen]).mean()
        print(f"  {kind:<20}{len(chosen):6d}  {'  '.join(shares)}  mean error {error:.3f}")


if __name__ == "__main__":
    sys.exit(tyro.cli(Train).run())
