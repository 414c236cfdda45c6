"""Segments: opened and closed by speech, gated, at the right times."""

import math

import numpy as np
import pytest
from spoken import in_noise, needs_espeak, say

from downbeat.perception.errors import PerceptionError
from downbeat.perception.segments import Segment, SegmentConfig, Segmenter, refusal
from downbeat.perception.vad import Vad

START_US = 5_000_000


@pytest.fixture(scope="module")
def vad():
    return Vad()


def hear(segmenter, samples, piece=800, start=START_US):
    found = []
    for at in range(0, len(samples), piece):
        found += segmenter.push(samples[at : at + piece], start + round(at / 16e3 * 1e6))
    return found


@needs_espeak
def test_two_utterances_with_a_pause_are_two_segments_at_their_times(vad):
    first, second = say("do the wave"), say("please stop dancing now")
    gap = np.zeros(16_000, np.float32)
    sound = in_noise(np.concatenate((first, gap, second)), before_s=1.0, after_s=1.0)
    found = hear(Segmenter(vad), sound)
    assert len(found) == 2
    begin = START_US + 1_000_000
    assert abs(found[0].start_utime - begin) < 350_000
    assert abs(found[1].start_utime - (begin + (len(first) + 16_000) * 1e6 / 16e3)) < 350_000
    assert found[1].voiced_fraction > 0.3
    for segment in found:
        assert segment.end_utime - segment.start_utime == pytest.approx(segment.duration_s * 1e6)
        at = round((segment.start_utime - START_US) / 1e6 * 16e3)
        np.testing.assert_array_equal(segment.samples, sound[at : at + len(segment.samples)])


@needs_espeak
def test_pieces_do_not_change_segments(vad):
    sound = in_noise(say("hello robot"), before_s=0.6, after_s=0.8)
    small, large = (hear(Segmenter(vad), sound, piece) for piece in (160, 7000))
    assert [(s.start_utime, s.end_utime) for s in small] == [
        (s.start_utime, s.end_utime) for s in large
    ]


@needs_espeak
def test_a_segment_closes_one_hang_over_after_the_voice(vad):
    speech = say("wave")
    (segment,) = hear(Segmenter(vad), in_noise(speech, before_s=0.5, after_s=1.0))
    end_of_voice = START_US + 500_000 + len(speech) / 16e3 * 1e6
    assert segment.closed_utime - end_of_voice < 400_000


@needs_espeak
def test_a_monologue_is_cut_and_goes_on(vad):
    text = "and then we went on and on about the weather and the harvest " * 4
    config = SegmentConfig(max_s=4.0, hang_over_s=1.0)
    found = hear(Segmenter(vad, config), in_noise(say(text), after_s=2.0))
    assert len(found) >= 3
    assert all(segment.duration_s <= 4.1 for segment in found)
    assert found[0].cut and not found[-1].cut


@needs_espeak
def test_speech_is_announced_before_it_has_ended(vad):
    opened = []
    segmenter = Segmenter(vad, on_open=opened.append)
    sound = in_noise(say("would you be so kind and stop dancing"), before_s=0.5, after_s=0.0)
    assert hear(segmenter, sound[:24_000]) == []
    assert len(opened) == 1 and segmenter.is_open


@needs_espeak
def test_a_gap_in_time_ends_the_segment(vad):
    speech = in_noise(say("walk like a zombie and then"), before_s=0.2, after_s=0.0)
    segmenter = Segmenter(vad)
    hear(segmenter, speech)
    assert segmenter.is_open
    found = segmenter.push(np.zeros(512, np.float32), START_US + 60_000_000)
    assert len(found) == 1 and not segmenter.is_open


def test_silence_and_noise_open_nothing(vad):
    rng = np.random.default_rng(0)
    for sound in (np.zeros(64_000, np.float32), 0.05 * rng.standard_normal(64_000)):
        assert hear(Segmenter(vad), sound.astype(np.float32)) == []


@pytest.mark.parametrize(
    ("voiced", "p_speech", "p_music", "forwarded"),
    [
        (0.8, 0.9, 0.1, True),
        (0.2, 0.9, 0.1, False),
        (0.8, 0.3, 0.5, False),
        (0.8, 0.5, 0.45, False),
        (0.8, math.nan, math.nan, True),
        (0.1, math.nan, math.nan, False),
    ],
)
def test_only_voiced_speech_above_music_is_forwarded(voiced, p_speech, p_music, forwarded):
    segment = Segment(0, 1_000_000, np.zeros(16_000, np.float32), voiced)
    config = SegmentConfig(min_voiced_fraction=0.3, epsilon=0.1)
    assert (refusal(segment, config, p_speech, p_music) == "") == forwarded


def test_thresholds_that_cannot_work_are_refused():
    with pytest.raises(PerceptionError, match="close <= open"):
        SegmentConfig(open_probability=0.3, close_probability=0.6)
