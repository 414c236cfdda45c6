"""The conductor: ahead of what it knows, quick after what it could not know."""

from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.setlist import SetEntry, SetList
from downbeat.catalog.tracks import Rule, Track
from downbeat.lcm_types import audio_class_t, music_match_t, skill_request_t
from downbeat.perception.conductor import Conductor
from downbeat.perception.timeline import Span, Timeline, tempo_octave

START = 1_700_000_000_000_000


@dataclass(frozen=True)
class Info:
    bpm: float
    duration_s: float = 4.0
    tempo_range_bpm: tuple[float, float] = (90.0, 150.0)


SKILLS = {n: Info(120.0) for n in ("a", "b", "c", "d")} | {"stand": Info(0.0, 1.0)}
TRACKS = {
    "one": Track("one", "d", BeatGrid(128.0), (Rule(0, 15, "a"), Rule(15, 60, "b"))),
    "two": Track("two", "c", BeatGrid(100.0)),
}


class Stage:
    """Feeds a conductor with locks every 250 ms and collects what it asks for."""

    def __init__(self, set_list=None):
        self.conductor = Conductor(Timeline(TRACKS, set_list), SKILLS)
        self.now = START
        self.sent = []

    def play(self, seconds, track=None, zero=0, lock=music_match_t.LOCKED, sounding=True):
        for step in range(round(seconds * 20)):
            if step % 5 == 0:
                label = audio_class_t.MUSIC if sounding else audio_class_t.SKIP
                self.conductor.sound(label, self.now)
                match = music_match_t()
                match.header.utime = self.now
                match.lock = lock if track else music_match_t.LOST
                match.track, match.track_zero_utime, match.rate = track or "", zero, 1.0
                self.conductor.hear(match)
            self.sent += [(self.now, msg) for msg in self.conductor.update(self.now)]
            self.now += 50_000

    def starts(self):
        return [(t, m) for t, m in self.sent if m.operation == skill_request_t.START]


def test_current_section_is_asked_for_at_once_and_the_next_one_ahead():
    stage = Stage()
    stage.play(8.0, "one", START - 2_000_000)
    (first_at, first), (second_at, second) = stage.starts()
    assert (first.skill, second.skill) == ("a", "b")
    assert first.start_utime == first_at == START
    assert second.start_utime == START + 13_000_000
    assert second.start_utime - second_at >= 4_000_000


def test_no_section_is_asked_for_twice():
    stage = Stage()
    stage.play(30.0, "one", START)
    assert [m.skill for _, m in stage.starts()] == ["a", "b"]
    ids = [m.request_id for _, m in stage.sent]
    assert ids == sorted(set(ids)) and ids[0] == 1


def test_cut_to_another_track_is_followed_at_once():
    stage = Stage()
    stage.play(6.0, "one", START)
    stage.play(1.0)
    stage.play(2.0, "two", START - 30_000_000)
    assert [m.skill for _, m in stage.starts()] == ["a", "b", "c"]
    at, request = stage.starts()[-1]
    assert request.start_utime == at


def test_lost_lock_cancels_what_was_planned():
    stage = Stage()
    stage.play(8.0, "one", START)
    stage.play(0.5)
    cancels = [m for _, m in stage.sent if m.operation == skill_request_t.CANCEL]
    planned = next(m for _, m in stage.starts() if m.skill == "b")
    assert [m.target_request_id for m in cancels] == [planned.request_id]


def test_doubtful_lock_plans_nothing():
    stage = Stage()
    stage.play(8.0, "one", START, lock=music_match_t.CANDIDATE)
    assert stage.sent == []


def test_set_list_announces_the_cut():
    show = SetList((SetEntry("one", 2.0, 10.0), SetEntry("two", 30.0, 10.0)))
    stage = Stage(show)
    stage.play(5.0, "one", START - 2_000_000)
    starts = stage.starts()
    assert [m.skill for _, m in starts] == ["a", "c"]
    assert starts[1][1].start_utime == START + 10_000_000


def test_set_list_carries_over_a_lost_lock():
    show = SetList((SetEntry("one", 2.0, 10.0), SetEntry("two", 30.0, 10.0)))
    stage = Stage(show)
    stage.play(8.0, "one", START - 2_000_000)
    stage.play(4.0)
    assert not [m for _, m in stage.sent if m.operation == skill_request_t.CANCEL]


def test_one_wrong_lock_does_not_move_an_announced_show():
    show = SetList((SetEntry("one", 2.0, 10.0), SetEntry("two", 30.0, 10.0)))
    stage = Stage(show)
    stage.play(4.0, "one", START - 2_000_000)
    stage.play(1.0, "one", START - 3_300_000)
    stage.play(3.0, "one", START - 2_000_000)
    assert [m.skill for _, m in stage.starts()] == ["a", "c"]


def test_silence_ends_in_stand_once():
    stage = Stage()
    stage.play(3.0, "one", START)
    stage.play(8.0, sounding=False)
    stands = [(t, m) for t, m in stage.starts() if m.skill == "stand"]
    assert len(stands) == 1
    assert 3.0e6 <= stands[0][0] - (START + 2_750_000) <= 3.3e6


def test_moved_lock_retimes_the_running_skill():
    stage = Stage()
    stage.play(4.0, "one", START)
    stage.play(2.0, "one", START + 12_000)
    retimes = [m for _, m in stage.sent if m.operation == skill_request_t.RETIME]
    assert [m.target_request_id for m in retimes] == [stage.starts()[0][1].request_id]


def test_steady_lock_retimes_nothing():
    stage = Stage()
    stage.play(20.0, "one", START)
    assert not [m for _, m in stage.sent if m.operation == skill_request_t.RETIME]


@given(st.floats(60, 200), st.floats(0, 40), st.floats(0, 20))
def test_skill_beats_fall_on_music_beats(bpm, start_s, later_s):
    timeline = Timeline({"t": Track("t", "a", BeatGrid(bpm))})
    span = Span("t", "a", START + round(start_s * 1e6), START)
    skill = Info(120.0)
    utime = span.start_utime + round(later_s * 1e6)
    fit = timeline.phase(span, skill, utime)
    skill_beats = fit.phase_s * skill.bpm / 60.0
    music_beats = (utime - START) * 1e-6 * bpm / 60.0
    octave = tempo_octave(bpm, skill.tempo_range_bpm)
    period = min(1.0, octave)
    difference = (skill_beats - octave * music_beats + period / 2) % period - period / 2
    assert difference == pytest.approx(0.0, abs=1e-3)
    assert fit.rate == pytest.approx(octave * bpm / skill.bpm)


@pytest.mark.parametrize(("bpm", "octave"), [(128, 1.0), (70, 2.0), (180, 0.5), (98, 1.0)])
def test_tempo_is_halved_or_doubled_into_the_range(bpm, octave):
    assert tempo_octave(bpm, (90.0, 150.0)) == octave
