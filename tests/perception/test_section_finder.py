"""Changes of unknown music: heard where they are, soon, and only once."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from downbeat.perception import section_features as sf
from downbeat.perception.errors import PerceptionError
from downbeat.perception.section_finder import SectionFinder, load_weights
from downbeat.tools.eval_sections import find_changes

RATE = sf.RATE_HZ
NOISE = np.random.default_rng(0).standard_normal(RATE * 8).astype(np.float32)


def tune(hertz, seconds, beat_s, seed):
    """A plain piece: a chord, a pulse and some noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    chord = sum(np.sin(2 * np.pi * hertz * r * t) for r in (1.0, 1.25, 1.5))
    pulse = np.exp(-((t % beat_s) * 20.0)) * rng.standard_normal(len(t))
    return (0.05 * chord + 0.1 * pulse).astype(np.float32)


def test_a_cut_between_two_pieces_is_told_within_two_seconds():
    first, second = tune(220.0, 12.0, 0.5, 1), tune(370.0, 8.0, 0.33, 2)
    told = find_changes(np.concatenate([first, 0.5 * second]))
    assert len(told) == 1
    where, when = told[0]
    assert abs(where - 12.0) <= 0.1
    assert when - 12.0 <= 2.0


def test_a_piece_that_goes_on_has_no_change():
    assert find_changes(tune(220.0, 25.0, 0.5, 1)) == []


def test_noise_and_silence_have_no_change():
    assert find_changes(0.05 * NOISE) == []
    assert find_changes(np.zeros(RATE * 8, np.float32)) == []


@settings(max_examples=8)
@given(st.lists(st.integers(1, 5_000), min_size=1, max_size=12), st.integers(0, 2**50))
def test_blocks_of_any_size_give_the_same(sizes, zero):
    sound = np.concatenate([tune(220.0, 6.0, 0.5, 1), tune(370.0, 4.0, 0.33, 2)])
    whole = SectionFinder().hear(sound, zero)
    finder, at, found = SectionFinder(), 0, None
    while at < len(sound):
        block = sound[at : at + sizes[at % len(sizes)]]
        found = finder.hear(block, zero + round(at * 1e6 / RATE)) or found
        at += len(block)
    assert found == whole
    assert whole is not None


def test_after_a_reset_nothing_of_before_counts():
    finder = SectionFinder()
    finder.hear(tune(220.0, 10.0, 0.5, 1), 0)
    finder.reset()
    assert finder.hear(tune(370.0, 6.0, 0.33, 2), 20_000_000) is None


def test_frames_of_a_stream_are_those_of_the_whole():
    sound = NOISE[: RATE * 2]
    whole = sf.FrameStream().push(sound)
    stream = sf.FrameStream()
    pieces = [f for at in range(0, len(sound), 333) for f in stream.push(sound[at : at + 333])]
    assert np.array_equal(np.array(whole), np.array(pieces))


def test_a_higher_threshold_tells_less():
    sound = np.concatenate([tune(220.0, 12.0, 0.5, 1), tune(370.0, 8.0, 0.33, 2)])
    deaf = replace(load_weights(), threshold=1e6)
    assert find_changes(sound, deaf) == []


def test_missing_weights_say_what_makes_them(tmp_path):
    with pytest.raises(PerceptionError, match="train_sections"):
        load_weights(tmp_path / "none.npz")
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 not weights")
    with pytest.raises(PerceptionError, match="train_sections"):
        load_weights(tmp_path / "bad.npz")
