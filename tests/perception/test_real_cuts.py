"""Cuts between real recordings, through the listener; skipped where there are none."""

import numpy as np
import pytest

from downbeat.perception.matcher import AlignmentMatcher
from downbeat.perception.source import audio_files, load_recording
from downbeat.tools.matcher_cuts import measure_cuts
from downbeat.tools.matcher_sounds import white_noise


@pytest.fixture(scope="module")
def library(real_music):
    found = [load_recording(path) for path in audio_files(real_music)]
    recordings = {r.name: r for r in found}
    matcher = AlignmentMatcher()
    for recording in found:
        matcher.add(recording.name, recording.samples, recording.sample_rate_hz)
    return matcher, recordings


@pytest.mark.parametrize("condition", [None, white_noise(10.0)], ids=["clean", "noise"])
def test_cuts_are_followed_fast_and_truly(library, condition):
    report = measure_cuts(*library, [17], condition, sections=14)
    lock_s = np.array(report.lock_s)
    assert len(lock_s) == 14
    assert report.wrong_locks == 0
    assert np.percentile(lock_s, 50) <= 1.6  # a lock that never came is NaN and fails too
    assert np.percentile(lock_s, 95) <= 2.2
    assert np.percentile(np.abs(report.same_sound_error_s), 95) <= 0.010
    assert report.elsewhere <= 0.01 * len(report.error_s)
    assert report.held >= 0.98 * report.hops
