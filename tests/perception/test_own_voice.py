"""Half duplex: the robot's own voice is recognised, somebody else's is not taken for it."""

import numpy as np
import pytest
from spoken import needs_espeak, say

from downbeat.perception.own_voice import LIKE, OwnVoice

START = 1_000_000_000


def room(sound, seed=0, gain=0.4):
    """A short reverberation, a loudspeaker's colour, noise."""
    rng = np.random.default_rng(seed)
    tail = rng.standard_normal(3200) * np.exp(-np.arange(3200) / 900)
    tail[0] = 3.0
    heard = np.convolve(sound, tail / np.abs(tail).sum())[: len(sound)]
    heard = np.convolve(heard, [1.0, -0.7])[: len(sound)]
    heard = heard / np.sqrt(np.mean(heard**2)) * 0.05 * gain
    return (heard + 0.003 * rng.standard_normal(len(sound))).astype(np.float32)


@needs_espeak
@pytest.mark.parametrize("delay_s", [0.0, 0.08, 0.4])
def test_the_own_voice_is_recognised_through_a_room(delay_s):
    own = OwnVoice()
    sound = say("I recognise the music by its fingerprint, and then I dance.")
    own.play((sound * 20_000).astype(np.int16), START)
    heard = room(np.concatenate([np.zeros(round(delay_s * 16_000), np.float32), sound]))
    assert own.is_own(heard, START, START + round(len(heard) / 16e3 * 1e6))
    part = heard[16_000:32_000]  # a segment may be a part of it
    assert own.is_own(part, START + 1_000_000, START + 2_000_000)


@needs_espeak
def test_somebody_who_speaks_into_it_is_heard():
    own = OwnVoice()
    sound = say("I recognise the music by its fingerprint, and then I dance.")
    own.play((sound * 20_000).astype(np.int16), START)
    echo = room(sound, gain=0.25)
    for text in ("please stop now", "do the twist", "walk forward two metres"):
        other = say(text, voice="en-gb")
        heard = echo[8_000 : 8_000 + len(other)].copy()
        heard += other[: len(heard)]
        assert own.likeness(heard, START + 500_000) < LIKE


@needs_espeak
def test_without_playback_nothing_is_own():
    own = OwnVoice()
    sound = say("hello there robot")
    assert not own.is_own(sound, START, START + 1_000_000)
    own.play((sound * 20_000).astype(np.int16), START)
    assert not own.is_own(sound, START + 20_000_000, START + 21_000_000)


def test_a_playback_that_was_cut_ends_there():
    own = OwnVoice()
    own.play(np.full(160_000, 1000, np.int16), START)
    own.stop(START + 1_000_000)
    assert own.is_near(START + 500_000, START + 700_000)
    assert not own.is_near(START + 3_000_000, START + 4_000_000)
