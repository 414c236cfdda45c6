"""Numbers in requests: what is said is what is meant, and never more than is safe."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.perception.grounding_numbers import (
    MAX_DISTANCE_M,
    MAX_DURATION_S,
    MAX_REPEAT,
    number,
    parameters,
)

UNIT_WORDS = (
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen "
    "sixteen seventeen eighteen nineteen"
)
UNITS = UNIT_WORDS.split()
TEN_WORDS = "_ _ twenty thirty forty fifty sixty seventy eighty ninety"
TENS = TEN_WORDS.split()


def spelt(value):
    if value < 20:
        return UNITS[value]
    if value < 100:
        return TENS[value // 10] + (" " + UNITS[value % 10] if value % 10 else "")
    rest = value % 100
    return UNITS[value // 100] + " hundred" + (" and " + spelt(rest) if rest else "")


@given(st.integers(0, 999))
def test_numbers_in_words_and_digits_are_the_same(value):
    assert number(spelt(value)) == number(str(value)) == value


@given(st.integers(0, 99), st.integers(0, 9))
def test_decimals_in_words_and_digits_are_the_same(whole, tenth):
    said = number(f"{spelt(whole)} point {UNITS[tenth]}")
    assert said == pytest.approx(whole + tenth / 10)
    assert number(f"{whole}.{tenth}") == pytest.approx(said)


@pytest.mark.parametrize(
    ("text", "value"),
    [("half", 0.5), ("two and a half", 2.5), ("half a", 0.5), ("a", 1), ("a hundred", 100),
     ("twenty-five", 25), ("", None), ("three four", None), ("zombie", None), ("point", None),
     ("twenty twelve", None)],
)  # fmt: skip
def test_spoken_fractions_and_nonsense(text, value):
    assert number(text) == value


@pytest.mark.parametrize(
    ("text", "rest", "expected"),
    [
        ("wave for five seconds", "wave", {"duration_s": 5.0}),
        ("walk forward two metres", "walk forward", {"distance_m": 2.0}),
        ("take four steps forward", "take forward", {"distance_m": 1.0}),
        ("twist twice", "twist", {"repeat": 2}),
        ("wave three times", "wave", {"repeat": 3}),
        ("waltz for half a minute", "waltz", {"duration_s": 30.0}),
        ("one more time", "", {"again": True}),
        ("do it again but faster", "do it but", {"again": True, "tempo": 1}),
        ("slow down", "", {"tempo": -1}),
        ("walk 1.5 m", "walk", {"distance_m": 1.5}),
    ],
)
def test_a_request_is_split_into_its_numbers_and_the_rest(text, rest, expected):
    found, left = parameters(text)
    assert left == rest
    for name in ("duration_s", "distance_m", "repeat"):
        assert getattr(found, name) == expected.get(name), name
    assert (found.again, found.tempo) == (expected.get("again", False), expected.get("tempo", 0))


@given(st.text(alphabet="abcdefghijklmnopqrstuvwxyz0123456789 .-", max_size=80))
def test_no_text_asks_for_more_than_is_safe(text):
    found, _ = parameters(text)
    assert found.duration_s is None or 0 < found.duration_s <= MAX_DURATION_S
    assert found.distance_m is None or 0 < found.distance_m <= MAX_DISTANCE_M
    assert found.repeat is None or 1 <= found.repeat <= MAX_REPEAT


@given(st.integers(1, 10**9), st.sampled_from(["metres", "minutes", "seconds", "times", "steps"]))
def test_huge_numbers_are_held_to_the_limit(value, unit):
    found, _ = parameters(f"walk {value} {unit}")
    assert found.distance_m is None or found.distance_m <= MAX_DISTANCE_M
    assert found.duration_s is None or found.duration_s <= MAX_DURATION_S


def test_small_words_are_no_amounts():
    assert parameters("walk as a zombie")[0].duration_s is None
    assert parameters("i am a robot")[0].distance_m is None
    assert parameters("do it twice as fast")[0].repeat is None
    assert parameters("do it twice as fast")[0].tempo == 1
    assert parameters("walk 2m")[0].distance_m == 2.0
