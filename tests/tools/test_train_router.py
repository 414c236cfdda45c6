"""What the router learns from is what its labels say, and the same every time."""

import numpy as np
import pytest

from downbeat.perception.router_frames import FrameStream
from downbeat.perception.vad import Vad
from downbeat.tools.router_singing import sing
from downbeat.tools.router_sounds import CLIP_S, Clip, heard, noises
from downbeat.tools.train_router import KIND_SHARES, Sounds, make_clip, make_rows

RATE = 16_000


def buzz(seed, seconds=10.0):
    """A buzz with moving formants and pauses, as loud as a voice."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    pitch = 120 + 20 * seed + 20 * np.sin(2 * np.pi * 0.7 * t)
    pulses = np.diff(np.floor(np.cumsum(pitch) / RATE), prepend=0.0)
    spoken = np.convolve(pulses, rng.standard_normal(60) * np.hanning(60), "same")
    return (0.2 * spoken * (np.sin(2 * np.pi * 3 * t) > -0.5)).astype(np.float32)


@pytest.fixture(scope="module")
def sounds():
    t = np.arange(10 * RATE) / RATE
    chord = sum(np.sin(2 * np.pi * f * t) for f in (220, 277, 330))
    return Sounds(
        songs={"song": (0.1 * chord * np.cos(t)).astype(np.float32)},
        music={f"music {n}": (0.1 * chord).astype(np.float32) for n in range(3)},
        people={f"person {n}": buzz(n) for n in range(3)},
        robots={"robot": buzz(5)},
        other={"wind": (0.1 * np.random.default_rng(0).standard_normal(10 * RATE)).astype("f4")},
    )


def test_clips_are_of_every_kind_finite_and_called_what_they_are(sounds):
    rng = np.random.default_rng(0)
    clips: list[Clip] = [make_clip(sounds, rng) for _ in range(60)]
    truth = {
        "music": {(1.0, 0.0)}, "song": {(1.0, 0.0)}, "sung": {(1.0, 0.0)},
        "speech": {(0.0, 1.0)}, "other": {(0.0, 0.0)},
    }  # fmt: skip
    assert {c.kind for c in clips} == {k for k in KIND_SHARES if k != "other on tape"}
    for clip in clips:
        assert len(clip.samples) == round(CLIP_S * RATE) and np.isfinite(clip.samples).all()
        assert np.abs(clip.samples).max() <= 1.0
        if clip.kind == "speech over music":
            assert max(clip.p_music, clip.p_speech) == 1.0
        else:
            assert (clip.p_music, clip.p_speech) in truth[clip.kind]


def test_the_same_seed_makes_the_same_rows(sounds):
    one, other = (make_rows(sounds, 4, 9, Vad()) for _ in range(2))
    np.testing.assert_array_equal(one.values, other.values)
    assert one.kinds == other.kinds and len(one.kinds) == 12


def test_no_source_is_trained_on_and_validated_with(sounds):
    train, check = sounds.half(False), sounds.half(True)
    for name in vars(sounds):
        assert not set(getattr(train, name)) & set(getattr(check, name))
    assert check.people and train.people


def test_sung_speech_is_voiced_and_has_a_melody():
    spoken = buzz(1, 6.0)
    sung = sing(spoken, np.random.default_rng(3))
    assert len(sung) == len(spoken) and np.isfinite(sung).all()

    def steady(samples):
        frames = FrameStream().push(samples)
        voiced = (frames.harmonicity > 0.6) & (frames.level > 0.01 * frames.level.max())
        pitches = frames.pitch[voiced]
        return len(pitches), len(np.unique(np.round(6 * pitches)))

    count, notes = steady(sung)
    assert count > 50 and notes > 2  # a melody, not a drone


def test_every_noise_is_finite_and_of_one_level():
    rng = np.random.default_rng(1)
    for _ in range(30):
        made = noises(2 * RATE, rng)
        assert np.isfinite(made).all()
        assert np.sqrt(np.mean(made**2)) == pytest.approx(1.0, abs=1e-3)
        assert np.isfinite(heard(made, rng)).all()
