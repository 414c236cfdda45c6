"""The verdict: noise is explained, what is missing is not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_music import RATE, make_music

from downbeat.perception import features as ft
from downbeat.perception.errors import PerceptionError
from downbeat.perception.index import QUANTUM
from downbeat.perception.verdict import (
    FORMAT,
    LEVELS,
    MEASURES,
    Line,
    Numbers,
    Verdict,
    agreement,
    learned,
    measure,
    share_that_agrees,
    variety,
    with_length,
)

NUMBERS = Numbers(similarity=0.3, second=0.2, chance=0.04, rate=1.0, pitch=1.0)
FRAMES = 62


def quantised(values):
    return np.round(values * QUANTUM).astype(np.int8)


@pytest.fixture(scope="module")
def spectra():
    """Return features of a piece, 5 s, and of another."""
    both = [ft.features(ft.to_matcher_rate(make_music(seed, 6.0), RATE)) for seed in (1, 2)]
    return both[0][:FRAMES], both[1][:FRAMES]


def test_what_is_missing_speaks_louder_than_what_is_too_much(spectra):
    """Noise adds energy where the reference has none; nothing takes away what is loud there."""
    reference = spectra[0]
    rng = np.random.default_rng(0)
    loud = reference > 1.0
    quiet = np.flatnonzero((reference < -0.25).ravel())
    missing, added = reference.copy(), reference.copy()
    missing[loud] = -1.0
    added.ravel()[rng.choice(quiet, loud.sum(), replace=False)] = 1.5
    with_missing, with_added = (
        learned().log_odds(query, quantised(reference), NUMBERS) for query in (missing, added)
    )
    assert with_missing < with_added - 3.0


def test_the_right_place_is_likelier_than_any_other(spectra):
    own, other = spectra
    right = learned().log_odds(own, quantised(own), NUMBERS)
    assert right > learned().log_odds(own, quantised(other), NUMBERS) + 2.0
    for shift in (5, 11, 29):
        assert right > learned().log_odds(own, quantised(np.roll(own, shift, 0)), NUMBERS) + 2.0


@given(lead=st.floats(0.0, 0.9), more=st.floats(0.001, 0.5))
def test_who_stands_further_above_the_second_is_never_less_likely(lead, more):
    values = np.random.default_rng(3).normal(size=(25, ft.NUM_BANDS)).clip(-1.5, 3.0)
    near, far = (
        learned().log_odds(
            values.astype(np.float32), quantised(values), Numbers(0.9, 0.9 - x, 0.04, 1.0, 1.0)
        )
        for x in (lead, lead + more)
    )
    assert far > near


def test_a_click_is_one_witness_however_alike_two_clicks_are(spectra):
    sound = np.zeros(6 * 16_000, np.float32)
    sound[32_000:32_800] = np.random.default_rng(1).standard_normal(800)
    click, music = ft.features(sound)[:FRAMES], spectra[0]
    assert share_that_agrees(agreement(click, quantised(click))) < 0.1
    assert share_that_agrees(agreement(music, quantised(music))) > 0.5
    assert share_that_agrees(np.zeros_like(click)) == 0.0
    same = Numbers(similarity=1.0, second=0.45, chance=0.06, rate=1.0, pitch=1.0)
    alike = learned().log_odds(click, quantised(click), same)
    assert alike < learned().log_odds(music, quantised(music), same) - 5.0


@given(
    sounds=st.integers(1, 6),
    hits=st.integers(1, 8),
    loudness=st.floats(0.01, 100.0),
    seed=st.integers(0, 99),
)
def test_variety_counts_different_sounds_however_often_and_loud_they_are(
    sounds, hits, loudness, seed
):
    """Bands of their own make sounds that have nothing in common."""
    rng = np.random.default_rng(seed)
    once = np.zeros((sounds, ft.NUM_BANDS), np.float32)
    for number, bands in enumerate(np.array_split(rng.permutation(ft.NUM_BANDS), sounds)):
        once[number, bands[: ft.NUM_BANDS // 6 - 1]] = 1.0
    heard = rng.permutation(np.repeat(once, hits, 0)) * np.float32(loudness)
    assert variety(heard) == pytest.approx(sounds, rel=1e-3)
    with_pauses = np.concatenate([heard, np.zeros_like(heard)])
    assert variety(with_pauses) == pytest.approx(sounds, rel=1e-3)


def test_where_nothing_agrees_there_is_no_variety():
    assert variety(np.zeros((FRAMES, ft.NUM_BANDS), np.float32)) == 1.0


@given(
    similarity=st.floats(0.1, 1.0),
    lead=st.floats(0.0, 0.29),
    bars=st.sampled_from([2, 4, 8]),
    frames=st.integers(16, 100),
)
def test_a_drum_that_is_hit_over_and_over_is_one_witness(spectra, similarity, lead, bars, frames):
    """Bands that are mixed anew in each bar: same cells, same share of the window, more sounds."""
    numbers = Numbers(similarity, similarity - lead, 0.1, 1.0, 1.0)
    loop = np.tile(spectra[0][8 : 8 + bars], (frames // bars + 1, 1))[:frames]
    rng = np.random.default_rng(0)
    parts = [loop[i : i + bars] for i in range(0, frames, bars)]
    mixed = np.concatenate([part[:, rng.permutation(ft.NUM_BANDS)] for part in parts])
    assert variety(agreement(loop, quantised(loop))) < 0.6 * variety(mixed.clip(0.0) ** 2)
    alike, varied = (learned().log_odds(x, quantised(x), numbers) for x in (loop, mixed))
    assert alike < varied - 0.5


def test_cells_are_shares_and_do_not_depend_on_the_length(spectra):
    query, reference = spectra[0], quantised(spectra[0])
    once = measure(query, reference, NUMBERS)
    twice = measure(np.tile(query, (2, 1)), np.tile(reference, (2, 1)), NUMBERS)
    assert once.shape == (MEASURES,)
    assert once[: LEVELS**2].sum() == pytest.approx(1.0)
    assert once == pytest.approx(twice)


def test_training_and_playing_weigh_alike(spectra):
    """The row that the script fits is what the process adds up."""
    query, reference = spectra[0][:30], quantised(spectra[1][:30])
    verdict = learned()
    row = with_length(measure(query, reference, NUMBERS), 30)
    assert verdict.log_odds(query, reference, NUMBERS) == pytest.approx(
        float(row @ verdict._weights) + verdict._bias
    )


@given(short=st.floats(0.5, 9.0), longer=st.floats(1.01, 3.0))
def test_a_shorter_window_must_be_surer(short, longer):
    for line in (learned().accept, learned().lock):
        assert line.of(short) > line.of(short * longer)
    assert Line(1.0, -2.0).of(5.0) == 1.0


@pytest.mark.parametrize("case", ["missing", "no numbers", "another format", "too short"])
def test_weights_that_cannot_be_read_are_named_in_one_sentence(tmp_path, case):
    path = tmp_path / "verdict.npz"
    whole = {"format": FORMAT, "weights": np.zeros(2 * MEASURES + 1), "bias": 0.0}
    lines = {"accept": np.zeros(2), "lock": np.zeros(2)}
    if case == "no numbers":
        path.write_bytes(b"no archive")
    elif case == "another format":
        np.savez(path, **{**whole, **lines, "format": FORMAT + 1})
    elif case == "too short":
        np.savez(path, **{**whole, **lines, "weights": np.zeros(5)})
    with pytest.raises(PerceptionError, match=r"verdict.npz cannot be read .*train_verdict") as e:
        Verdict(path)
    assert "\n" not in str(e.value)
