"""The constellation matcher: right track and place, and nothing where there is nothing."""

import numpy as np
import pytest
from synthetic_music import RATE, make_music

from downbeat.perception.constellation import ConstellationMatcher
from downbeat.perception.errors import PerceptionError
from downbeat.perception.index import Index
from downbeat.perception.landmarks import MAX_STEP, MIN_STEP, find_peaks, landmarks_of, pair_peaks


@pytest.fixture(scope="module")
def constellation(matcher):
    return ConstellationMatcher(matcher.index)


def window(samples, start_s, seconds):
    return samples[round(start_s * RATE) : round((start_s + seconds) * RATE)]


@pytest.mark.parametrize("noise_db", [None, 10.0, 3.0])
def test_windows_are_found_at_their_place(constellation, music, noise_db):
    rng = np.random.default_rng(1)
    right = total = 0
    for name, samples in music.items():
        for start_s in rng.uniform(0, 34, 8):
            sound = window(samples, start_s, 5.0)
            if noise_db is not None:
                noise = rng.standard_normal(len(sound)).astype(np.float32)
                sound = sound + noise * np.sqrt((sound**2).mean()) * 10 ** (-noise_db / 20)
            result = constellation.query(sound, RATE)
            total += 1
            right += result.accepted and result.track == name
            assert 0.0 <= result.confidence <= 1.0
            if result.accepted:
                assert (result.track, result.tau_s) == (name, pytest.approx(start_s, abs=0.08))
    assert right >= (0.95 if noise_db is None else 0.85) * total


@pytest.mark.parametrize("seed", [90, 91, 92, 93])
def test_unknown_music_is_not_accepted(constellation, seed):
    assert not constellation.query(make_music(seed, 5.0), RATE).accepted


@pytest.mark.parametrize(
    "sound",
    [
        np.zeros(5 * RATE, np.float32),
        np.random.default_rng(0).standard_normal(5 * RATE).astype(np.float32) * 0.1,
        0.3 * np.sin(2 * np.pi * 440 * np.arange(5 * RATE) / RATE).astype(np.float32),
        np.zeros(10, np.float32),
        np.full(10, 0.5, np.float32),
        np.full(5 * RATE, np.nan, np.float32),
        np.full(5 * RATE, 0.5, np.float32),
    ],
    ids=["silence", "noise", "tone", "ten zeros", "ten samples", "not finite", "constant"],
)
def test_what_is_no_music_is_not_accepted(constellation, sound):
    result = constellation.query(sound, RATE)
    assert not result.accepted
    assert np.isfinite([result.tau_s, result.confidence, result.similarity]).all()


def test_it_reads_the_same_index_as_the_alignment_matcher(matcher, music, tmp_path):
    matcher.save(tmp_path / "index.bin")
    loaded = ConstellationMatcher.load(tmp_path / "index.bin")
    sound = window(music["piece1"], 20.0, 5.0)
    assert loaded.query(sound, RATE) == ConstellationMatcher(matcher.index).query(sound, RATE)


def test_agreement_is_high_at_the_place_and_low_elsewhere(constellation, music):
    sound = window(music["piece0"], 15.0, 3.0)
    here, correction_s = constellation.agreement(sound, RATE, "piece0", 15.04)
    assert here > 0.4
    assert correction_s == pytest.approx(-0.04, abs=0.03)
    assert constellation.agreement(sound, RATE, "piece0", 25.0)[0] < 0.1
    assert constellation.agreement(sound, RATE, "unknown", 15.0) == (0.0, 0.0)


def test_wrong_input_is_one_sentence(constellation):
    with pytest.raises(PerceptionError, match="8000 Hz"):
        constellation.query(np.ones(4000, np.float32), 4000)
    with pytest.raises(PerceptionError, match="holds no track"):
        ConstellationMatcher().query(np.ones(4 * RATE, np.float32), RATE)


def test_a_plateau_is_one_peak():
    values = np.zeros((60, 100), np.int8)
    values[20:26, 50:53] = 127
    frames, bands = find_peaks(values)
    assert (frames.tolist(), bands.tolist()) == ([20], [50])


def test_pairs_keep_their_interval_when_the_pitch_changes():
    rng = np.random.default_rng(0)
    frames = np.sort(rng.integers(0, 300, 80))
    bands = rng.integers(10, 90, 80)
    low, high = pair_peaks(frames, bands), pair_peaks(frames, bands + 1)
    assert len(low) > 100
    assert (np.unique(high[:, 0] - low[:, 0])).size == 1
    steps = low[:, 0] & 63
    assert steps.min() >= MIN_STEP and steps.max() <= MAX_STEP


def test_landmarks_do_not_depend_on_where_the_excerpt_starts(matcher):
    fine = matcher.index.fine[0]
    whole = {(k, f) for k, f in landmarks_of(fine).tolist()}
    part = {(k, f + 200) for k, f in landmarks_of(fine[200:500]).tolist() if 20 < f < 200}
    assert len(part & whole) >= 0.95 * len(part) > 20


def test_silent_features_have_no_landmarks():
    assert landmarks_of(np.zeros((0, 100), np.int8)).shape == (0, 2)
    assert landmarks_of(np.zeros((50, 100), np.int8)).shape == (0, 2)
    assert Index().all_landmarks() == []
