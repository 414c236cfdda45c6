"""Tracks get dances that are certified for their tempo."""

import numpy as np
import pytest

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.perception.source import Recording
from downbeat.policies.manifest import load_skills
from downbeat.tools.recordings import assign_skills, fits_tempo

SKILLS = load_skills()
DANCES = [n for n, m in SKILLS.items() if m.bpm > 0 and m.kind != "locomotion"]


@pytest.mark.parametrize("seed", range(20))
def test_every_track_gets_a_dance_that_fits_its_tempo(seed):
    rng = np.random.default_rng(seed)
    names = [f"track{k}" for k in range(16)]
    grids = {n: BeatGrid(float(rng.uniform(60.0, 190.0))) for n in names}
    silent = {n: Recording(n, np.zeros(100, np.float32), 100) for n in names}
    tracks = assign_skills(silent, grids, DANCES, seed)
    for name, track in tracks.items():
        wanted = SKILLS[track.default_skill].tempo_range_bpm
        assert fits_tempo(grids[name].tempo_bpm, wanted)
    assert len({t.default_skill for t in tracks.values()}) >= 12


def test_half_and_double_time_fit_and_what_has_no_beat_always_does():
    assert fits_tempo(70.0, (80.0, 160.0))
    assert fits_tempo(190.0, (80.0, 160.0))
    assert not fits_tempo(88.5, (95.0, 160.0))
    assert fits_tempo(33.0, (0.0, 0.0))
