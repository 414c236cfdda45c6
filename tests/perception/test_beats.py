"""Beat grids of recordings."""

import numpy as np
import pytest

from downbeat.perception.beats import FALLBACK_BPM, estimate_grid, grid_from_beats

RATE = 22_050


def struck(beats, rate=RATE, accent=4):
    """Return drums on beats; every `accent`-th one with a bass drum, and a new chord there."""
    sound = np.zeros(round((beats[-1] + 1.0) * rate))
    t = np.arange(rate // 5) / rate
    noise = np.random.default_rng(1).standard_normal(len(t)) * np.exp(-t * 60.0)
    bass = np.sin(2 * np.pi * 70.0 * t) * np.exp(-t * 15.0)
    for number, beat in enumerate(beats):
        start = round(beat * rate)
        hit = 0.3 * noise + (bass if number % accent == 0 else 0.0)
        chord = 220.0 * 2 ** ((number // accent * 5 % 12) / 12.0)
        hit = hit + 0.2 * np.sin(2 * np.pi * chord * t) * np.exp(-t * 4.0)
        sound[start : start + len(t)] += hit[: len(sound) - start]
    return (0.5 * sound).astype(np.float32)


def test_even_beats_give_their_tempo_and_phase():
    rng = np.random.default_rng(0)
    beats = 0.31 + np.arange(100) * 60.0 / 97.0 + rng.normal(0, 0.008, 100)
    grid = grid_from_beats(beats)
    assert grid.tempo_bpm == pytest.approx(97.0, abs=0.05)
    assert not grid.beat_times_s
    error = (grid.first_beat_s - 0.31 + 0.15) % (60.0 / 97.0) - 0.15
    assert error == pytest.approx(0.0, abs=0.01)


def test_a_missed_beat_does_not_shift_the_grid():
    beats = np.delete(np.arange(60) * 0.5, [20, 21, 40])
    assert grid_from_beats(beats).tempo_bpm == pytest.approx(120.0, abs=0.01)


def test_breathing_tempo_keeps_its_beats_but_smooth():
    gaps = 0.5 + 0.06 * np.sin(np.arange(80) / 8.0)
    beats = np.concatenate([[0.2], 0.2 + np.cumsum(gaps)])
    grid = grid_from_beats(beats)
    assert len(grid.beat_times_s) == len(beats)
    assert np.abs(np.array(grid.beat_times_s) - beats).max() < 0.25


def test_too_few_beats_fall_back():
    assert grid_from_beats(np.array([1.0, 2.0])).tempo_bpm == FALLBACK_BPM


def error_s(grid, beats):
    """Return how far each true beat is from the grid's nearest beat [s]."""
    return np.array([t - grid.time_of(round(grid.beats_at(t))) for t in beats])


@pytest.mark.parametrize("bpm", [98.0, 117.3, 128.0, 140.0])
def test_even_music_gets_its_tempo_its_beats_and_its_downbeat(bpm):
    beats = 0.37 + np.arange(64) * 60.0 / bpm
    grid = estimate_grid(struck(beats), RATE)
    assert grid.tempo_bpm == pytest.approx(bpm, abs=0.05)
    assert not grid.beat_times_s
    assert np.abs(error_s(grid, beats)).max() < 0.02
    assert round(grid.beats_at(beats[0])) % 4 == 0


def test_later_sound_is_a_later_grid():
    beats = 0.2 + np.arange(48) * 0.5
    early, late = (estimate_grid(struck(beats + shift_s), RATE) for shift_s in (0.0, 0.173))
    assert late.tempo_bpm == pytest.approx(early.tempo_bpm, abs=0.02)
    assert np.median(error_s(early, beats)) == pytest.approx(
        np.median(error_s(late, beats + 0.173)), abs=0.005
    )


def test_music_that_breathes_keeps_its_own_beats():
    gaps = 0.5 + 0.03 * np.sin(np.arange(90) / 10.0)
    beats = 0.3 + np.concatenate([[0.0], np.cumsum(gaps)])
    grid = estimate_grid(struck(beats), RATE)
    assert grid.beat_times_s
    assert np.percentile(np.abs(error_s(grid, beats[2:-2])), 90) < 0.03


def test_breathing_grid_does_not_drift_from_its_beats():
    rng = np.random.default_rng(3)
    gaps = 0.5 + 0.04 * np.sin(np.arange(200) / 25.0) + rng.normal(0.0, 0.008, 200)
    beats = 0.3 + np.concatenate([[0.0], np.cumsum(gaps)])
    times = np.array(grid_from_beats(beats).beat_times_s)
    assert np.abs(times - beats).max() < 0.04
    assert np.diff(times).std() < np.diff(beats).std()


@pytest.mark.parametrize("level", [0.0, 1e-3])
def test_sound_without_beats_falls_back_and_does_not_fail(level):
    sound = np.full(RATE * 4, level, np.float32)
    assert estimate_grid(sound, RATE).tempo_bpm == FALLBACK_BPM


def test_the_same_sound_has_the_same_grid_twice():
    sound = struck(0.1 + np.arange(40) * 0.47)
    assert estimate_grid(sound, RATE) == estimate_grid(sound, RATE)
