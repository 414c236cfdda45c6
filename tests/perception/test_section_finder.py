"""Changes of unknown music: heard where they are, soon, and only once."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from downbeat.perception import section_features as sf
from downbeat.perception.errors import PerceptionError
from downbeat.perception.section_context import AFTER, LAST, NUM_INPUTS, USUAL, Context, Tail
from downbeat.perception.section_finder import MIN_PAST, PEAK, Picker, SectionFinder, load_weights
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


def streamed(sound, size):
    """Frames of a sound handed over in blocks, one by one."""
    stream = sf.FrameStream()
    return [f for at in range(0, len(sound), size) for f in stream.push(sound[at : at + size])]


def test_frames_of_a_stream_are_those_of_the_whole():
    sound = NOISE[: RATE * 2]
    whole, pieces = sf.FrameStream().push(sound), streamed(sound, 333)
    for part in ("long", "short", "fine"):
        a, b = ([getattr(frame, part) for frame in frames] for frames in (whole, pieces))
        assert np.array_equal(a, b)
    (together,) = sf.FrameStream().push(sound, together=True)
    assert np.abs(together.long - np.concatenate([f.long for f in whole])).max() < 1e-4


def test_inputs_of_one_frame_at_a_time_are_those_of_many():
    sound = np.concatenate([tune(220.0, 14.0, 0.5, 1), tune(370.0, 12.0, 0.33, 2)])
    maps = load_weights().maps
    (frames,) = sf.FrameStream().push(sound, together=True)
    many = Context(maps).push(frames)
    one = Context(maps)
    rows = []
    for k in range(len(frames)):
        part = slice(k, k + 1)
        rows.append(one.push(sf.Frames(frames.long[part], frames.short[part], frames.fine[part])))
    assert many.shape == (len(frames) - AFTER, NUM_INPUTS)
    assert np.isfinite(many).all()
    assert np.abs(np.concatenate(rows) - many).max() < 1e-3


def test_inputs_forget_what_is_older_than_they_look_back():
    rng = np.random.default_rng(0)
    count, back = 400, AFTER + USUAL + LAST
    whole = sf.Frames(
        rng.standard_normal((count, sf.NUM_LONG), dtype=np.float32),
        rng.standard_normal((count, sf.NUM_SHORT, sf.SHORT_BANDS), dtype=np.float32),
        rng.random((count, sf.NUM_FINE), dtype=np.float32),
    )
    maps = load_weights().maps
    last = Context(maps).push(whole)[-1]
    for changed, same in ((count - back - 1, True), (count - back + 40, False)):
        other = sf.Frames(*(part.copy() for part in vars(whole).values()))
        other.long[changed] += 3.0
        # Running sums are rounded differently after other frames: not bit by bit.
        assert np.allclose(Context(maps).push(other)[-1], last, rtol=0.0, atol=1e-8) == same


def test_a_tail_knows_its_rows_by_number():
    tail = Tail(3)
    for first in range(0, 10, 2):
        tail.append(np.arange(first, first + 2)[:, None])
    assert tail.end == 10
    assert tail.at(np.array([[7, 8], [9, 9]]))[..., 0].tolist() == [[7, 8], [9, 9]]


def test_the_most_likely_moment_is_picked_and_the_next_rests():
    odds = np.full(MIN_PAST + 60, -5.0)
    odds[5] = 9.0  # before there is enough of a past
    odds[MIN_PAST + 10 : MIN_PAST + 13] = 1.0, 2.0, 1.5
    odds[MIN_PAST + 30] = 3.0  # within two seconds
    odds[MIN_PAST + 50] = 0.5
    picker = Picker(0.25)
    told = [(n, found) for n, one in enumerate(odds) if (found := picker.push(one))]
    assert [n for n, _ in told] == [MIN_PAST + 11 + PEAK, MIN_PAST + 50 + PEAK]
    places, novelty = zip(*(found for _, found in told))
    assert novelty == (1.75, 0.25)
    assert MIN_PAST + 11 < places[0] < MIN_PAST + 11.1  # towards the more likely neighbour
    assert places[1] == pytest.approx(MIN_PAST + 50)


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
