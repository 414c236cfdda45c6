"""Fixtures of the perception tests."""

import pytest
from synthetic_music import RATE, make_music


@pytest.fixture(scope="session")
def music():
    """Three pieces of 40 s."""
    return {f"piece{seed}": make_music(seed, 40.0) for seed in range(3)}


@pytest.fixture(scope="session")
def matcher(music):
    from downbeat.perception.matcher import AlignmentMatcher

    made = AlignmentMatcher()
    for name, samples in music.items():
        made.add(name, samples, RATE)
    made.finish()
    return made
