"""Beat grids: maps between seconds and beats."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.errors import CatalogError

grids = st.one_of(
    st.builds(BeatGrid, st.floats(60, 200), st.floats(-1, 2)),
    st.lists(st.floats(0.2, 1.0), min_size=3, max_size=40).map(
        lambda gaps: BeatGrid(
            120.0, beat_times_s=tuple(sum(gaps[: i + 1]) for i in range(len(gaps)))
        )
    ),
)


@given(grids, st.floats(-20, 200))
def test_seconds_to_beats_and_back_is_the_identity(grid, track_s):
    assert grid.time_of(grid.beats_at(track_s)) == pytest.approx(track_s, abs=1e-6)


@given(grids, st.floats(-20, 200), st.floats(0.01, 20))
def test_later_in_the_track_is_later_in_beats(grid, track_s, step):
    assert grid.beats_at(track_s + step) > grid.beats_at(track_s)


@given(st.floats(60, 200), st.floats(0, 100))
def test_tempo_of_a_constant_grid_is_its_tempo(bpm, track_s):
    assert BeatGrid(bpm).bpm_at(track_s) == bpm


@pytest.mark.parametrize("bpm", [0.0, -3.0, 1000.0, float("nan")])
def test_impossible_tempo_says_what_is_valid(bpm):
    with pytest.raises(CatalogError, match="valid are 30"):
        BeatGrid(bpm)


def test_beats_must_rise():
    with pytest.raises(CatalogError, match="rising"):
        BeatGrid(120.0, beat_times_s=(0.0, 1.0, 0.5))
