"""The conductor under any traffic: what it asks for always makes sense."""

import math

from hypothesis import given
from hypothesis import strategies as st

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.setlist import SetEntry, SetList
from downbeat.catalog.tracks import Rule, Track
from downbeat.lcm_types import audio_class_t, audio_source_t, music_match_t, skill_request_t
from downbeat.perception.conductor import Conductor
from downbeat.perception.conductor_node import ConductorNode
from downbeat.perception.music_requests import RETIME_PERIOD_US
from downbeat.perception.timeline import Span, Timeline
from downbeat.runtime.clock import SimClock
from downbeat.runtime.memq import MemqHub

START = 1_700_000_000_000_000
HOP_US, STEP_US = 250_000, 50_000


class Info:
    """A skill, as the conductor sees it."""

    def __init__(self, bpm, duration_s=4.0):
        self.bpm, self.duration_s, self.tempo_range_bpm = bpm, duration_s, (95.0, 150.0)


SKILLS = {"a": Info(120.0), "b": Info(120.0, 8.0), "wave": Info(0.0, 5.0), "stand": Info(0.0, 1.0)}
BREATHING = tuple(0.3 + 0.5 * beat + 0.05 * math.sin(beat / 9.0) for beat in range(160))
TRACKS = {
    "even": Track("even", "a", BeatGrid(128.0), (Rule(5, 12, "b"), Rule(12, 13, "wave"))),
    "slow": Track("slow", "b", BeatGrid(70.0, 0.4)),
    "live": Track("live", "wave", BeatGrid(120.0, beat_times_s=BREATHING), (Rule(2, 30, "a"),)),
}
SHOW = SetList((SetEntry("even", 0.0, 8.0), SetEntry("live", 1.0, 9.0), SetEntry("even", 4.0, 9.0)))

hearing = st.tuples(
    st.sampled_from(["", *TRACKS]),
    st.integers(-2_000_000, 25_000_000),  # position in the track [us]
    st.sampled_from([music_match_t.LOST, music_match_t.CANDIDATE, music_match_t.LOCKED]),
    st.integers(1, 24),  # hops that it lasts
    st.booleans(),  # sounding
)
traffic = st.lists(hearing, min_size=1, max_size=8)


def match_message(utime, track, lock, zero):
    match = music_match_t()
    match.header.utime = utime
    match.lock = lock if track else music_match_t.LOST
    match.track, match.rate = track, 1.0
    match.track_zero_utime = zero
    return match


def class_message(utime, sounding):
    heard = audio_class_t()
    heard.header.utime = heard.window_end_utime = utime
    heard.window_start_utime = utime - 1_000_000
    heard.label = audio_class_t.MUSIC if sounding else audio_class_t.SKIP
    heard.rms_dbfs = -20.0 if sounding else -90.0
    heard.p_music = heard.p_speech = heard.v_frac = math.nan
    return heard


def conduct(events, set_list):
    """Return (utime, request) of everything asked for."""
    conductor = Conductor(Timeline(TRACKS, set_list), SKILLS)
    now, sent = START, []
    for track, place_us, lock, hops, sounding in events:
        zero = now - place_us
        for step in range(hops * HOP_US // STEP_US):
            if step * STEP_US % HOP_US == 0:
                conductor.sound(class_message(now, sounding).label, now)
                conductor.hear(match_message(now, track, lock, zero))
            sent += [(now, request) for request in conductor.update(now)]
            now += STEP_US
    return sent


@given(traffic, st.sampled_from([None, SHOW]))
def test_requests_are_numbered_from_one_without_a_gap(events, set_list):
    sent = conduct(events, set_list)
    assert [request.request_id for _, request in sent] == list(range(1, len(sent) + 1))


@given(traffic, st.sampled_from([None, SHOW]))
def test_cancel_and_retime_name_a_request_that_still_counts(events, set_list):
    alive = set()
    for _, request in conduct(events, set_list):
        if request.operation == skill_request_t.START:
            alive.add(request.request_id)
        else:
            assert request.target_request_id in alive
        if request.operation == skill_request_t.CANCEL:
            alive.remove(request.target_request_id)


@given(traffic, st.sampled_from([None, SHOW]))
def test_at_most_one_request_waits_for_a_boundary(events, set_list):
    waiting = {}
    for now, request in conduct(events, set_list):
        waiting = {key: start for key, start in waiting.items() if start > now}
        if request.operation == skill_request_t.CANCEL:
            waiting.pop(request.target_request_id, None)
        elif request.operation == skill_request_t.START and request.start_utime > now:
            waiting[request.request_id] = request.start_utime
        assert len(waiting) <= 1


@given(traffic, st.sampled_from([None, SHOW]))
def test_every_phase_line_can_be_danced(events, set_list):
    for now, request in conduct(events, set_list):
        if request.operation == skill_request_t.CANCEL:
            continue
        skill = SKILLS[request.skill]
        assert request.start_utime >= now - STEP_US
        assert 0.0 <= request.start_phase_s <= skill.duration_s
        if skill.bpm == 0.0:
            assert (request.start_phase_s, request.phase_rate) == (0.0, 1.0)
        else:
            assert 0.6 <= request.phase_rate <= 1.5


@given(traffic, st.sampled_from([None, SHOW]))
def test_retimes_come_at_most_twice_a_second(events, set_list):
    times = [t for t, m in conduct(events, set_list) if m.operation == skill_request_t.RETIME]
    assert all(late - early >= RETIME_PERIOD_US for early, late in zip(times, times[1:]))


@given(traffic)
def test_without_a_lock_nothing_is_asked_for_but_rest(events):
    unlocked = [
        (track, place, min(lock, music_match_t.CANDIDATE), hops, sounding)
        for track, place, lock, hops, sounding in events
    ]
    assert all(request.skill == "stand" for _, request in conduct(unlocked, None))


@given(traffic, st.sampled_from([None, SHOW]))
def test_the_same_traffic_has_the_same_answer(events, set_list):
    first, second = (
        [(t, m.operation, m.skill, m.start_utime, m.start_phase_s) for t, m in sent]
        for sent in (conduct(events, set_list), conduct(events, set_list))
    )
    assert first == second


def rig():
    """Return (hub endpoint of the listener, of control, the conductor's node, clock)."""
    clock = SimClock(START)
    hub = MemqHub()
    listener = hub.endpoint("listener", clock)
    control = hub.endpoint("control", clock)
    control.subscribe("SKILL_REQUEST")
    conductor = Conductor(Timeline(TRACKS), SKILLS)
    node = ConductorNode(hub.endpoint("conductor", clock), conductor, frozenset(TRACKS))
    return listener, control, node, clock


def requests(control):
    control.pump()
    return [received.msg for received in control.take("SKILL_REQUEST")]


def test_node_hears_and_asks_over_the_bus():
    listener, control, node, _ = rig()
    listener.publish("AUDIO_CLASS", class_message(START, True))
    listener.publish("MUSIC_MATCH", match_message(START, "even", music_match_t.LOCKED, START))
    node.step(START)
    node.step(START + STEP_US)  # one skill per decision
    now_request, ahead = requests(control)
    assert (now_request.skill, now_request.start_utime) == ("a", START)
    assert (ahead.skill, ahead.start_utime) == ("b", START + 5_000_000)
    assert now_request.source == skill_request_t.SOURCE_MUSIC


def test_node_ignores_tracks_without_rules():
    listener, control, node, _ = rig()
    listener.publish("MUSIC_MATCH", match_message(START, "other", music_match_t.LOCKED, START))
    node.step(START)
    assert requests(control) == []


def test_end_of_the_sound_is_the_end_of_the_dance():
    listener, control, node, _ = rig()
    listener.publish("AUDIO_CLASS", class_message(START, True))
    listener.publish("MUSIC_MATCH", match_message(START, "slow", music_match_t.LOCKED, START))
    node.step(START)
    ended = audio_source_t()
    ended.header.utime = START + STEP_US
    ended.state, ended.first_sample_utime = audio_source_t.FINISHED, START
    ended.sample_rate_hz, ended.duration_s = 44_100, 10.0
    listener.publish("AUDIO_SOURCE", ended)
    for step in range(1, 5):
        node.step(START + step * STEP_US)
    assert [request.skill for request in requests(control)] == ["b", "stand"]


@given(st.floats(1.0, 70.0), st.floats(0.0, 0.5))
def test_phase_line_stays_on_breathing_beats_until_the_next_look(tau_s, later_s):
    skill = Info(120.0, 8.0)
    utime = START + round(tau_s * 1e6)
    line = Timeline(TRACKS).phase(Span("live", "a", START + 2_000_000, START), skill, utime)
    beats = (line.phase_s + line.rate * later_s) * skill.bpm / 60.0
    error_beats = (beats - TRACKS["live"].grid.beats_at(tau_s + later_s) + 0.5) % 1.0 - 0.5
    assert abs(error_beats) * 0.5 < 0.005  # a beat lasts half a second
