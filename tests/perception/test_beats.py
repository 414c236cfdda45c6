"""Beat grids of recordings."""

import numpy as np
import pytest

from downbeat.perception.beats import FALLBACK_BPM, estimate_grid, grid_from_beats


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


def test_clicks_are_found():
    rate = 22_050
    sound = np.zeros(20 * rate, np.float32)
    for beat in np.arange(0.25, 19.5, 0.5):
        start = round(beat * rate)
        sound[start : start + 400] += np.hanning(400) * np.sin(np.arange(400) * 0.4)
    assert estimate_grid(sound, rate).tempo_bpm == pytest.approx(120.0, abs=1.0)
