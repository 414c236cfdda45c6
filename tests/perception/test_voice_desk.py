"""Speech before music: commands, stops, gestures, and the body handed back on the moment."""

from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_conductor import SKILLS as MUSIC_SKILLS
from test_conductor import START, TRACKS, Info

from downbeat.lcm_types import (
    audio_class_t,
    music_match_t,
    skill_request_t,
    skill_status_t,
    speech_intent_t,
    speech_t,
)
from downbeat.perception.conductor import Conductor
from downbeat.perception.timeline import Timeline

LOOP = {"loop": True, "command": None}


def skill(bpm, duration_s=4.0, **more):
    info = Info(bpm, duration_s)
    fields = {"bpm": bpm, "duration_s": duration_s, "tempo_range_bpm": info.tempo_range_bpm}
    return SimpleNamespace(**{**fields, **LOOP, **more})


SKILLS = {name: skill(info.bpm, info.duration_s) for name, info in MUSIC_SKILLS.items()} | {
    "talk": skill(0.0, 6.0),
    "wave": skill(0.0, 5.0, loop=False),
    "walk": skill(0.0, 1.0, command=object()),
    "salsa": skill(120.0),
}


class Stage:
    """A conductor, and a control that does what it is asked half a second later."""

    def __init__(self, track="one", zero_s=-16.0, delay_s=0.5, allowed=None, obeys=True):
        self.conductor = Conductor(Timeline(TRACKS), SKILLS, allowed, hold_s=6.0)
        self.now = START
        self.track, self.zero = track, START + round(zero_s * 1e6)
        self.delay_us = round(delay_s * 1e6)
        self.obeys = obeys
        self.sent, self.pending, self.running = [], [], None
        self.history = []

    def take(self, messages):
        for msg in messages:
            self.sent.append((self.now, msg))
            if msg.operation == skill_request_t.START and self.obeys:
                due = max(self.now + self.delay_us, msg.start_utime)
                if msg.start_utime <= self.now:
                    self.pending = [p for p in self.pending if p[1].start_utime > self.now]
                self.pending = sorted([*self.pending, (due, msg)], key=lambda p: p[0])
            elif msg.operation == skill_request_t.CANCEL:
                self.pending = [p for p in self.pending if p[1].request_id != msg.target_request_id]

    def status(self, msg, state, onset=0):
        out = skill_status_t()
        out.header.utime, out.request_id, out.source = self.now, msg.request_id, msg.source
        out.skill, out.state, out.onset_utime = msg.skill, state, onset
        self.take(self.conductor.follow(out, self.now))

    def run(self, seconds):
        for step in range(round(seconds * 20)):
            if step % 5 == 0 and self.track:
                self.conductor.sound(audio_class_t.MUSIC, self.now)
                match = music_match_t()
                match.header.utime, match.lock, match.rate = self.now, music_match_t.LOCKED, 1.0
                match.track, match.track_zero_utime = self.track, self.zero
                self.conductor.hear(match)
            for due, msg in [p for p in self.pending if p[0] <= self.now]:
                self.pending.remove((due, msg))
                if self.running is not None:
                    self.status(self.running[0], skill_status_t.PREEMPTED)
                self.running = (msg, self.now)
                self.history.append((self.now, msg.skill, msg.source))
                self.status(msg, skill_status_t.RUNNING, self.now)
            if self.running is not None and self.running[0].duration_s:
                msg, since = self.running
                if self.now >= since + msg.duration_s * 1e6:
                    self.running = None
                    # As control does: what comes within 1.5 s is awaited without standing first.
                    if not any(due - self.now < 1_500_000 for due, _ in self.pending):
                        self.history.append((self.now, "stand", -1))
                    self.status(msg, skill_status_t.DONE)
            self.take(self.conductor.update(self.now))
            self.now += 50_000

    def say(self, kind, skill="", **more):
        msg = speech_intent_t()
        msg.header.utime, msg.kind, msg.skill, msg.text = self.now, kind, skill, "words"
        for name, value in more.items():
            setattr(msg, name, value)
        self.take(self.conductor.listen(msg, self.now))

    def speak(self, state, duration_s=3.0, gesture="talk"):
        msg = speech_t()
        msg.header.utime, msg.state, msg.duration_s = self.now, state, duration_s
        msg.start_utime, msg.gesture = self.now, gesture
        self.take(self.conductor.speak(msg, self.now))

    def playing(self):
        return self.history[-1][1]


def test_a_command_takes_the_body_and_the_music_takes_it_back_when_it_ends():
    stage = Stage()
    stage.run(3.0)
    assert stage.playing() == "b"
    stage.say(speech_intent_t.SKILL, "salsa")
    stage.run(4.0)
    assert stage.playing() == "salsa"
    stage.run(6.0)
    assert [name for _, name, _ in stage.history] == ["b", "salsa", "b"]
    taken, back = stage.history[1][0], stage.history[2][0]
    assert back - taken == pytest.approx(6e6, abs=60_000), "no gap in stand"


def test_what_takes_the_body_back_is_asked_for_ahead_and_in_phase():
    stage = Stage()
    stage.run(3.0)
    stage.say(speech_intent_t.SKILL, "salsa")
    stage.run(12.0)
    starts = [m for _, m in stage.sent if m.operation == skill_request_t.START and m.skill == "b"]
    asked = next(t for t, m in stage.sent if m is starts[-1])
    assert starts[-1].start_utime - asked > 2_000_000
    first, last = starts[0], starts[-1]
    beat_s = 0.5
    drift = last.start_phase_s - first.start_phase_s
    drift -= first.phase_rate * (last.start_utime - first.start_utime) * 1e-6
    assert abs((drift + beat_s / 2) % beat_s - beat_s / 2) < 0.01


def test_a_stop_stands_at_once_and_the_music_stays_away():
    stage = Stage()
    stage.run(3.0)
    stage.say(speech_intent_t.STOP)
    last = stage.sent[-1][1]
    assert (last.skill, last.operation, last.start_utime) == (
        "stand", skill_request_t.START, stage.now
    )  # fmt: skip
    stage.run(20.0)
    assert stage.playing() == "stand"
    stage.say(speech_intent_t.RESUME)
    stage.run(2.0)
    assert stage.playing() == "b"


def test_a_stop_cancels_what_the_music_had_planned():
    stage = Stage(zero_s=-10.0)
    stage.run(2.0)
    planned = [m for _, m in stage.sent if m.operation == skill_request_t.START][-1]
    assert planned.start_utime > stage.now, "the next section is planned"
    stage.say(speech_intent_t.STOP)
    cancelled = [
        m.target_request_id for _, m in stage.sent if m.operation == skill_request_t.CANCEL
    ]
    assert planned.request_id in cancelled


def test_forbidding_what_is_not_done_stops_nothing():
    stage = Stage()
    stage.run(3.0)
    sent = len(stage.sent)
    stage.say(speech_intent_t.STOP, "salsa", negated=True)
    assert len(stage.sent) == sent
    stage.say(speech_intent_t.STOP, "b", negated=True)
    assert stage.sent[-1][1].skill == "stand"


def test_a_gesture_lasts_as_long_as_the_sound_and_the_dance_resumes():
    stage = Stage()
    stage.run(3.0)
    stage.speak(speech_t.REQUESTED, 3.0)
    stage.run(0.6)
    assert stage.playing() == "talk"
    stage.speak(speech_t.STARTED, 3.0)
    begun = stage.now
    stage.run(3.0)
    stage.speak(speech_t.FINISHED, 3.0)
    stage.run(2.0)
    assert stage.playing() == "b"
    assert stage.history[-1][0] - begun == pytest.approx(3e6, abs=120_000)


def test_an_interrupted_command_goes_on_after_the_answer():
    stage = Stage(track="")
    stage.say(speech_intent_t.SKILL, "salsa", duration_s=20.0)
    stage.run(3.0)
    stage.speak(speech_t.REQUESTED, 2.0)
    stage.run(0.6)
    stage.speak(speech_t.STARTED, 2.0)
    stage.run(2.0)
    stage.speak(speech_t.FINISHED, 2.0)
    stage.run(3.0)
    names = [name for _, name, _ in stage.history]
    assert names[:3] == ["salsa", "talk", "salsa"]
    stage.run(20.0)
    total = [t for t, name, _ in stage.history if name == "stand"][-1] - stage.history[0][0]
    assert total == pytest.approx(20e6, abs=1e6)


def test_after_a_stop_answers_come_without_a_gesture():
    stage = Stage()
    stage.run(3.0)
    stage.say(speech_intent_t.STOP)
    stage.run(1.0)
    sent = len(stage.sent)
    stage.speak(speech_t.REQUESTED)
    assert len(stage.sent) == sent


def test_numbers_become_lengths_and_repeats():
    stage = Stage(track="")
    stage.say(speech_intent_t.SKILL, "walk", distance_m=2.0)
    assert stage.sent[-1][1].duration_s == pytest.approx(10.0)
    assert stage.sent[-1][1].velocity[0] == pytest.approx(0.2)
    stage.say(speech_intent_t.SKILL, "walk", distance_m=1.0, text="walk back")
    assert stage.sent[-1][1].velocity[0] < 0
    stage.say(speech_intent_t.SKILL, "salsa", repeat=3)
    assert stage.sent[-1][1].duration_s == pytest.approx(12.0)
    stage.say(speech_intent_t.SKILL, "a", duration_s=7.0)
    stage.run(1.0)
    stage.say(speech_intent_t.AGAIN)
    assert stage.sent[-1][1].skill == "a"


def test_a_gesture_without_a_loop_is_repeated():
    stage = Stage(track="")
    stage.say(speech_intent_t.SKILL, "wave", repeat=3)
    for _ in range(3):
        stage.run(1.0)
        stage.status(stage.running[0], skill_status_t.DONE)
    stage.run(1.0)
    assert [name for _, name, _ in stage.history] == ["wave"] * 3
    assert stage.conductor.voice.claim is None


def test_faster_and_slower_change_the_rate_from_where_the_phase_is():
    stage = Stage(track="")
    stage.say(speech_intent_t.SKILL, "salsa")
    stage.run(2.0)
    stage.say(speech_intent_t.TEMPO, tempo=1)
    msg = stage.sent[-1][1]
    assert msg.operation == skill_request_t.RETIME
    assert msg.phase_rate == pytest.approx(1.1)
    assert msg.start_phase_s == pytest.approx(2.0, abs=0.06)


def test_what_is_not_allowed_is_not_asked_for():
    stage = Stage(allowed=frozenset({"wave"}))
    stage.run(1.0)
    sent = len(stage.sent)
    stage.say(speech_intent_t.SKILL, "salsa")
    stage.say(speech_intent_t.SKILL, "no such skill")
    stage.say(speech_intent_t.AGAIN)
    assert len(stage.sent) == sent


def test_a_refused_command_leaves_the_body_to_the_music():
    stage = Stage(obeys=False)
    stage.run(1.0)
    stage.say(speech_intent_t.SKILL, "salsa")
    stage.status(stage.sent[-1][1], skill_status_t.REFUSED)
    stage.run(1.0)
    assert stage.sent[-1][1].skill == "b"


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_whatever_is_said_every_id_is_new_and_the_body_comes_free(data):
    stage = Stage()
    kinds = [getattr(speech_intent_t, k) for k in ("STOP", "SKILL", "AGAIN", "TEMPO", "RESUME")]
    for _ in range(data.draw(st.integers(1, 6))):
        if data.draw(st.booleans()):
            name = data.draw(st.sampled_from(["salsa", "wave", "walk", "a", "nobody"]))
            kind = data.draw(st.sampled_from(kinds))
            stage.say(kind, name, repeat=data.draw(st.integers(0, 2)), tempo=1)
        else:
            stage.speak(speech_t.REQUESTED, 1.5)
            stage.run(data.draw(st.sampled_from([0.2, 0.7])))
            stage.speak(speech_t.STARTED, 1.5)
            stage.run(1.5)
            stage.speak(speech_t.FINISHED, 1.5)
        stage.run(data.draw(st.sampled_from([0.1, 1.0, 3.0])))
    ids = [m.request_id for _, m in stage.sent]
    assert len(set(ids)) == len(ids)
    stage.say(speech_intent_t.RESUME)
    for _ in range(6):
        stage.run(5.0)
        if stage.running is not None and stage.running[0].skill == "wave":
            stage.status(stage.running[0], skill_status_t.DONE)
    assert stage.conductor.voice.claim is None
    assert stage.playing() in ("b", "d"), "what the track asks for at that place"
