"""Section changes: their score, their mashups, and that what is learned tells pieces apart."""

import numpy as np
import pytest

from downbeat.perception import section_features as sf
from downbeat.perception.section_finder import MIN_PAST, load_weights
from downbeat.perception.source import Recording
from downbeat.tools.eval_sections import (
    NEAR_S,
    SectionScore,
    find_changes,
    interval,
    mashup_of,
    sound_of,
)
from downbeat.tools.section_mashups import MASHUP_S, pool_of, varied_mashup
from downbeat.tools.train_sections import frames_of, inputs_of, learn, nearest_frames, save

RATE = sf.RATE_HZ


def piece(number, seconds=45.0):
    """A plain piece of its own key, tempo and timbre."""
    rng = np.random.default_rng(number)
    t = np.arange(round(seconds * RATE)) / RATE
    root = 110.0 * 2.0 ** rng.uniform(0.0, 2.0)
    beat_s = rng.uniform(0.3, 0.7)
    steps = rng.choice([1.0, 1.125, 1.25, 1.5], 8)
    pitch = root * steps[(t / beat_s).astype(int) % 8]
    tone = np.sin(2.0 * np.pi * np.cumsum(pitch) / RATE)
    pulse = np.exp(-((t % beat_s) * rng.uniform(8.0, 30.0))) * rng.standard_normal(len(t))
    sound = 0.1 * np.tanh(rng.uniform(0.5, 4.0) * tone) + rng.uniform(0.02, 0.2) * pulse
    return Recording(f"game{number % 2}_{number}", sound.astype(np.float32), RATE)


def level(number, seconds=60.0):
    """A recording that is told by its level."""
    samples = np.full(round(seconds * RATE), 0.1 * (number + 1), np.float32)
    return Recording(f"level_{number}", samples, RATE)


def test_a_change_is_counted_once_and_where_it_is():
    score = SectionScore()
    told = [(3.0, 4.8), (20.05, 21.9), (20.4, 22.2), (39.3, 41.1), (70.0, 71.8)]
    score.add(told, [20.0, 40.0, 60.0])
    assert (score.told, score.cuts) == (4, 3)  # what is told in the first 5 s does not count
    assert (score.found, score.close, score.rough) == (1, 1, 2)
    assert score.latency_s == pytest.approx([1.9])


def test_the_interval_of_a_share_is_wilsons():
    assert interval(45, 50) == pytest.approx((0.7864, 0.9565), abs=1e-3)
    assert interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize("fade_s", [0.0, 0.5])
def test_cuts_are_where_the_sound_changes(fade_s):
    tracks = [level(number) for number in range(3)]
    rng = np.random.default_rng(1)
    sound, cuts_s = mashup_of(tracks, 40.0, (8.0, 8.0), rng, fade_s)
    assert len(cuts_s) >= 4
    for cut_s in cuts_s:
        before, after = (round((cut_s + side * (0.5 * fade_s + 0.01)) * RATE) for side in (-1, 1))
        assert sound[before] != sound[after]
        assert np.ptp(sound[before - 100 : before]) == np.ptp(sound[after : after + 100]) == 0.0


def test_varied_mashups_name_their_cuts():
    pool = pool_of([level(number) for number in range(5)])
    assert [len(kin) for kin in pool.kin] == [5]
    for seed in (3, 4, 7, 9):  # without noise, room and fades
        sound, cuts = varied_mashup(pool, np.random.default_rng(seed))
        assert len(sound) == MASHUP_S * RATE
        jumps = np.flatnonzero(np.abs(np.diff(sound)) > 1e-4 * np.abs(sound).max()) + 1
        assert len(jumps) < 1000  # cuts, and what resampling makes of an end
        assert set(cuts) <= set(jumps.tolist())


def test_what_is_learned_tells_pieces_apart(tmp_path):
    pool = pool_of([piece(number) for number in range(10)])
    weights = learn(pool, 10.0, np.random.default_rng(0))
    save(weights, tmp_path / "weights.npz")
    load_weights.cache_clear()
    loaded = load_weights(tmp_path / "weights.npz")
    load_weights.cache_clear()
    sound, cuts_s = mashup_of([piece(n) for n in range(20, 26)], 60.0, (10.0, 10.0),
                              np.random.default_rng(2))  # fmt: skip
    inputs = inputs_of(frames_of(sound), loaded.maps)
    odds = loaded.log_odds(inputs)
    at = nearest_frames([round(cut * RATE) for cut in cuts_s])
    far = np.abs(np.arange(len(odds))[:, None] - at).min(1) > 10
    far[:MIN_PAST] = False
    highest = [odds[k - 2 : k + 3].max() for k in at]
    assert np.mean(highest > np.quantile(odds[far], 0.95)) >= 0.8
    own = weights.log_odds(inputs_of(frames_of(sound), weights.maps))
    assert np.abs(own - odds).max() < 0.2  # half precision


@pytest.mark.slow
def test_the_cuts_of_real_music_are_found(real_music):
    tracks = sound_of(real_music)
    score = SectionScore()
    for number in range(6):
        rng = np.random.default_rng([5, number])
        sound, cuts_s = mashup_of(tracks, 120.0, (20.0, 20.0), rng)
        score.add(find_changes(sound), cuts_s)
    assert score.cuts == 30
    assert score.recall >= 0.8, score.text()
    assert score.precision >= 0.8, score.text()
    assert max(score.latency_s) <= 2.0 + NEAR_S
