"""Music that nobody knows: the conductor dances on the beat that is heard."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_conductor import SKILLS, START, TRACKS, Info

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.tracks import Rule, Track
from downbeat.lcm_types import audio_class_t, music_beat_t, music_match_t, skill_request_t
from downbeat.perception.chunk_conductor import ChunkConductor
from downbeat.perception.conductor import Conductor
from downbeat.perception.conductor_config import ConductorConfig
from downbeat.perception.improviser import Improviser
from downbeat.perception.timeline import PhaseFit, Timeline
from downbeat.runtime.config import ConfigError, config_from


def beat_message(now, bpm, first_utime, section_utime=0, state=music_beat_t.FOLLOWING):
    msg = music_beat_t()
    msg.header.utime = now
    msg.state = state
    period_us = 60e6 / bpm
    msg.beat_utime = first_utime + round(math.floor((now - first_utime) / period_us) * period_us)
    msg.period_s = period_us * 1e-6
    msg.section_utime = section_utime
    return msg


def like_message(now, track):
    msg = music_match_t()
    msg.header.utime = now
    msg.method = music_match_t.EMBEDDING
    msg.track, msg.rate, msg.similarity = track, 1.0, 0.8
    return msg


def lock_message(now, track, zero, confidence=5.0, votes=60):
    msg = music_match_t()
    msg.header.utime = now
    msg.method, msg.lock, msg.accepted = music_match_t.FINGERPRINT, music_match_t.LOCKED, True
    msg.track, msg.track_zero_utime, msg.rate = track, zero, 1.0
    msg.confidence, msg.votes = confidence, votes
    return msg


def lost_message(now):
    msg = music_match_t()
    msg.header.utime = now
    return msg


class Floor:
    """Plays unknown music to a conductor and keeps what it asks for."""

    def __init__(self, config=None, tracks=TRACKS, skills=SKILLS):
        improviser = Improviser(tracks, skills)
        self.conductor = Conductor(
            Timeline(tracks), skills, config=config or ConductorConfig(), improviser=improviser
        )
        self.now = START
        self.sent = []

    def play(self, seconds, bpm=128.0, like="one", section_utime=0, label=audio_class_t.MUSIC):
        for step in range(round(seconds * 20)):
            if step % 5 == 0:
                self.conductor.sound(label, self.now)
                self.conductor.hear(lost_message(self.now))
                if bpm:
                    self.conductor.beat(beat_message(self.now, bpm, START, section_utime))
            if like and step % 20 == 0:
                self.conductor.hear(like_message(self.now, like))
            self.sent += [(self.now, msg) for msg in self.conductor.update(self.now)]
            self.now += 50_000
        return self

    def starts(self):
        return [m for _, m in self.sent if m.operation == skill_request_t.START]


def test_unknown_music_gets_the_skill_of_the_most_similar_track_on_a_beat():
    (start,) = Floor().play(12.0).starts()
    assert start.skill == "d"  # the default skill of "one"
    assert start.start_utime >= START + 5_000_000
    beats = (start.start_utime - START) * 1e-6 * 128.0 / 60.0
    assert abs(beats - round(beats)) * 60.0 / 128.0 < 1e-4
    assert start.start_phase_s == 0.0
    assert start.phase_rate == pytest.approx(128.0 / 120.0)


def test_without_a_beat_or_with_unknown_music_ignored_nobody_improvises():
    assert Floor().play(12.0, bpm=0.0).starts() == []
    assert Floor(ConductorConfig(unknown="ignore")).play(12.0).starts() == []


def test_speech_alone_is_no_music():
    assert Floor().play(12.0, label=audio_class_t.SPEECH).starts() == []


def test_a_section_change_brings_the_next_skill_of_that_track():
    floor = Floor().play(10.0, section_utime=0)
    changed = floor.now
    floor.play(3.0, section_utime=changed)
    assert [m.skill for m in floor.starts()] == ["d", "a"]
    assert changed <= floor.starts()[1].start_utime < changed + 1_000_000


def test_another_resemblance_must_last_before_the_skill_changes():
    floor = Floor().play(10.0).play(3.0, like="two").play(3.0, like="one")
    assert [m.skill for m in floor.starts()] == ["d"]
    floor.play(12.0, like="two")
    assert [m.skill for m in floor.starts()] == ["d", "c"]


def test_a_lock_takes_over_at_once():
    floor = Floor().play(10.0)
    floor.conductor.hear(lock_message(floor.now, "two", START))
    (asked,) = floor.conductor.update(floor.now)
    assert (asked.skill, asked.start_utime) == ("c", floor.now)


def test_a_dance_that_the_tempo_forbids_gives_way_to_one_that_it_allows():
    slow = {"a": Info(70.0, 4.0, (60.0, 75.0)), "b": Info(120.0, 4.0, (90.0, 130.0))}
    tracks = {"one": Track("one", "a", BeatGrid(70.0), (Rule(0, 5, "b"),))}
    (start,) = Floor(tracks=tracks, skills=slow).play(8.0, bpm=100.0).starts()
    assert start.skill == "b"


@given(st.floats(60.0, 200.0), st.floats(0.0, 4.0), st.floats(0.8, 1.2), st.integers(0, 10**6))
def test_following_moves_a_dance_to_the_nearest_beat(bpm, phase_s, rate, offset_us):
    improviser = Improviser(TRACKS, SKILLS)
    now = START + 3_000_000
    improviser.beat(beat_message(now, bpm, START + offset_us))
    line = PhaseFit(now - 700_000, phase_s, rate)
    fit = improviser.follow("a", line, now)
    running = phase_s + rate * 0.7
    moved = (fit.phase_s - running + 2.0) % 4.0 - 2.0  # the loop lasts 4 s
    assert abs(moved) <= 0.25 + 1e-6  # half a beat of the dance
    pulse = improviser.pulse(now)
    at_beat = fit.phase_s + fit.rate * (pulse.next_beat(now) - now) * 1e-6
    beats = at_beat * 120.0 / 60.0
    step = min(fit.rate * 120.0 / bpm, 1.0)  # skill beats per music beat
    assert abs(beats / step - round(beats / step)) * step < 0.01


def test_a_beat_that_is_heard_an_octave_lower_does_not_slow_the_dance():
    improviser = Improviser(TRACKS, {**SKILLS, "a": Info(120.0, 4.0, (75.0, 160.0))})
    now = START + 3_000_000
    improviser.beat(beat_message(now, 150.0, START))
    line = improviser.begin("a", now)
    improviser.beat(beat_message(line.utime, 75.0, START))
    fit = improviser.follow("a", line, line.utime)
    assert fit.rate == pytest.approx(line.rate) == pytest.approx(150.0 / 120.0)
    error_s = (fit.phase_s - line.phase_s + 0.25) % 0.5 - 0.25  # of a beat of the dance
    assert abs(error_s) < 0.001


def test_a_match_below_the_gates_is_no_lock():
    for config in (ConductorConfig(min_confidence=6.0), ConductorConfig(min_votes=100)):
        floor = Floor(config)
        floor.conductor.sound(audio_class_t.MUSIC, START)
        floor.conductor.hear(lock_message(START, "one", START))
        assert floor.conductor.update(START) == []
        floor.conductor.hear(lock_message(START, "one", START, confidence=7.0, votes=200))
        assert len(floor.conductor.update(START)) == 1


def test_a_wavering_lock_does_not_make_the_robot_waver():
    floor = Floor()
    for turn in range(8):  # another track every 300 ms
        floor.conductor.sound(audio_class_t.MUSIC, floor.now)
        floor.conductor.hear(lock_message(floor.now, ("one", "two")[turn % 2], START - 20_000_000))
        for _ in range(6):
            floor.sent += [(floor.now, msg) for msg in floor.conductor.update(floor.now)]
            floor.now += 50_000
    assert len(floor.starts()) == 4  # b, c; and each once more after its cool-down
    begun = {}
    for start in floor.starts():
        assert start.start_utime - begun.get(start.skill, 0) >= 2_000_000
        begun[start.skill] = start.start_utime


@given(st.lists(st.sampled_from(["one", "two", ""]), min_size=1, max_size=40))
def test_at_most_one_skill_is_asked_for_per_decision(tracks):
    floor = Floor()
    for name in tracks:
        floor.conductor.sound(audio_class_t.MUSIC, floor.now)
        heard = (
            lock_message(floor.now, name, START - 8_000_000) if name else lost_message(floor.now)
        )
        floor.conductor.hear(heard)
        asked = floor.conductor.update(floor.now)
        assert sum(m.operation == skill_request_t.START for m in asked) <= 1
        floor.now += 250_000


def test_the_papers_conductor_reacts_chunk_by_chunk():
    conductor = ChunkConductor(TRACKS, SKILLS)
    asked = []
    for second in range(0, 40, 5):
        now = START + second * 1_000_000
        conductor.sound(audio_class_t.MUSIC, now)
        match = lock_message(now, "one", 0)
        match.lock, match.tau_s = music_match_t.CANDIDATE, float(second)
        if second == 20:
            match.accepted = False  # a chunk that was not recognised changes nothing
        conductor.hear(match)
        asked += [(second, m.skill, m.start_utime - now) for m in conductor.update(now)]
    assert asked == [(0, "a", 0), (15, "b", 0)]


def test_a_wrong_setting_says_which():
    with pytest.raises(ConfigError, match=r"hearing.toml.*look_ahead_s = -1 must lie in 0..60"):
        config_from({"look_ahead_s": -1.0}, ConductorConfig, "hearing.toml")
