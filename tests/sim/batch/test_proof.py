"""A bound holds at every look, and over the whole course of a proof."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.sim.batch.pair import CONFIDENCE
from downbeat.sim.batch.proof import at_most, fixed_upper_bound, lower_bound, upper_bound

BLOCK = 64
LOOKS = 16
SEQUENCES = 3000


def looks(share: float, seed: int) -> np.ndarray:
    """Falls so far at every look, (SEQUENCES, LOOKS)."""
    rng = np.random.default_rng([seed, round(share * 1e6)])
    return np.cumsum(rng.binomial(BLOCK, share, (SEQUENCES, LOOKS)), axis=1)


@pytest.mark.parametrize("share", [0.001, 0.003, 0.01, 0.03, 0.1, 0.4])
def test_at_most_one_sequence_in_twenty_ever_breaks_its_bound(share):
    fallen = looks(share, 1)
    bound = np.array(
        [[upper_bound(int(f), BLOCK * (k + 1)) for k, f in enumerate(row)] for row in fallen]
    )
    assert np.mean((bound < share).any(axis=1)) <= 0.05


@pytest.mark.parametrize("share", [0.01, 0.1, 0.4])
def test_the_lower_bound_holds_at_every_look_too(share):
    fallen = looks(share, 2)
    bound = np.array(
        [[lower_bound(int(f), BLOCK * (k + 1)) for k, f in enumerate(row)] for row in fallen]
    )
    assert np.mean((bound > share).any(axis=1)) <= 0.05


def test_a_textbook_interval_would_not_survive_the_looks():
    share = 0.01
    fallen = looks(share, 3)
    bound = np.array(
        [[fixed_upper_bound(int(f), BLOCK * (k + 1)) for k, f in enumerate(row)] for row in fallen]
    )
    assert np.mean((bound < share).any(axis=1)) > 0.05


def test_the_attempts_of_a_proof_err_in_five_per_cent_together():
    assert sum(1.0 - confidence for confidence in CONFIDENCE) <= 0.05 + 1e-12


@given(count=st.integers(1, 4000), share=st.floats(0.0, 1.0), confidence=st.floats(0.8, 0.999))
def test_a_bound_lies_above_what_was_seen(count, share, confidence):
    fallen = round(share * count)
    low, high = (bound(fallen, count, confidence) for bound in (lower_bound, upper_bound))
    assert 0.0 <= low <= fallen / count <= high <= 1.0


@given(count=st.integers(1, 2000), fallen=st.integers(0, 30))
def test_more_clean_rollouts_never_loosen_a_bound_and_a_fall_always_does(count, fallen):
    count += fallen
    assert upper_bound(fallen, count + 64) <= upper_bound(fallen, count)
    assert upper_bound(fallen + 1, count + 1) >= upper_bound(fallen, count + 1)


def test_zero_falls_give_the_figures_of_the_documents():
    assert upper_bound(0, 340) == pytest.approx(0.01, rel=0.02)
    assert upper_bound(0, 1280) == pytest.approx(0.003, rel=0.03)
    assert upper_bound(0, 0) == 1.0
    assert fixed_upper_bound(0, 299) == pytest.approx(0.01, rel=0.01)
    assert at_most(0, 299, 0.01) == pytest.approx(0.05, rel=0.02)
