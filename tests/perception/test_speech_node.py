"""The speech process: what it does with commands, monologues, foreign words, nothing and noise."""

import numpy as np
import pytest
from spoken import RATE, in_noise, needs_espeak, say

from downbeat.lcm_types import audio_chunk_t, speech_intent_t
from downbeat.perception.early_guess import Guesses, ends_a_pause
from downbeat.perception.errors import PerceptionError
from downbeat.perception.recognisers import Recognition
from downbeat.perception.segments import SegmentConfig, Segmenter
from downbeat.perception.speech_config import SpeechConfig, VoiceConfig
from downbeat.perception.speech_mouth import Mouth
from downbeat.perception.speech_node import SpeechNode
from downbeat.perception.speech_work import SimulatedWorker
from downbeat.perception.vad import Vad
from downbeat.policies.manifest import load_skills
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.tools.speech_parts import make_ears

pytest.importorskip("pocketsphinx")
FEED_S = 0.05
WORK_US = 100_000


@pytest.fixture(scope="module")
def ears():
    try:
        return make_ears(SpeechConfig(voice=VoiceConfig(backend="text")), load_skills())
    except PerceptionError as error:
        pytest.skip(str(error))


class Room:
    """A speech process that hears what a test says, on simulated time."""

    def __init__(self, ears, recogniser=None, **settings):
        if recogniser is not None:
            from dataclasses import replace

            ears = replace(ears, recogniser=recogniser)
        self.clock = SimClock(SIM_EPOCH_UTIME)
        hub = MemqHub()
        bus = hub.endpoint("speech", self.clock)
        self.listener = hub.endpoint("listener", self.clock)
        self.watcher = hub.endpoint("watcher", self.clock)
        self.watcher.subscribe("TRANSCRIPT", "SPEECH_INTENT", "SPEECH")
        self.worker = SimulatedWorker(WORK_US)
        ears.segmenter.flush()
        self.node = SpeechNode(
            bus, ears, Mouth(bus, None, ""), self.worker, load_skills(), **settings
        )
        self.intents, self.transcripts, self.said = [], [], []
        self.sent = 0

    def hear(self, sound, after_s=1.0):
        """Let it hear a sound and some quiet room after it."""
        rng = np.random.default_rng(7)
        quiet = 1e-4 * rng.standard_normal(round(after_s * RATE)).astype(np.float32)
        sound = np.concatenate((sound, quiet))
        piece = round(FEED_S * RATE)
        for at in range(0, len(sound), piece):
            self.feed((32767 * np.clip(sound[at : at + piece], -1, 1)).astype(np.int16))
            self.pass_time(FEED_S)
        return self

    def feed(self, pcm):
        msg = audio_chunk_t()
        msg.header.utime = self.clock.utime()
        msg.first_sample, msg.sample_rate_hz = self.sent, RATE
        msg.first_sample_utime = SIM_EPOCH_UTIME + self.sent * 1_000_000 // RATE
        msg.samples, msg.num_samples = pcm, len(pcm)
        self.sent += len(pcm)
        self.listener.publish("AUDIO_CHUNK", msg)

    def pass_time(self, seconds):
        end = self.clock.utime() + round(seconds * 1e6)
        while self.clock.utime() < end:
            self.clock.advance_to(min(end, self.clock.utime() + 20_000))
            self.node.step(self.clock.utime())
            self.watcher.pump()
            self.intents += [r.msg for r in self.watcher.take("SPEECH_INTENT")]
            self.transcripts += [r.msg for r in self.watcher.take("TRANSCRIPT")]
            self.said += [r.msg for r in self.watcher.take("SPEECH")]

    def commands(self):
        return [msg for msg in self.intents if msg.kind != speech_intent_t.CHAT]


class Hears:
    """A recogniser that hears what a test wants."""

    name = "test"

    def __init__(self, text):
        self.text = text
        self.heard_s = []

    def recognise(self, samples, language="en"):
        self.heard_s.append(len(samples) / RATE)
        return Recognition(self.text, 0.9, self.name, 1000, tuple(self.text.split()))


@needs_espeak
def test_a_command_becomes_one_intent_before_its_pause_is_over(ears):
    sound = in_noise(say("walk like a zombie"), 30.0, before_s=0.6, after_s=0.0)
    end = SIM_EPOCH_UTIME + round(len(sound) / RATE * 1e6)
    room = Room(ears).hear(sound)
    (intent,) = room.commands()
    assert intent.skill == "zombie"
    assert intent.header.utime - end < 400_000


@needs_espeak
def test_what_goes_on_after_a_short_pause_is_one_utterance(ears):
    """A hundred milliseconds of pause begin a guess; the voice that follows makes it worthless."""
    first, second = say("dance like a robot"), say("would be the wrong thing to do")
    first = first[: np.flatnonzero(np.abs(first) > 0.01)[-1]]
    gap = np.zeros(round(0.12 * RATE), np.float32)
    hears = Hears("")
    room = Room(ears, hears)
    room.hear(in_noise(np.concatenate((first, gap, second)), 30.0, before_s=0.6, after_s=0.0))
    assert len(room.transcripts) == 1, hears.heard_s
    assert hears.heard_s[-1] > len(first) / RATE + 1.5


@needs_espeak
def test_a_monologue_of_half_a_minute_asks_for_nothing_and_blocks_nothing(ears):
    text = "and then we went on and on about the weather and the harvest and the old mill "
    sound = np.tile(in_noise(say(text), 30.0, before_s=0.1, after_s=0.0), 7)[: 30 * RATE]
    room = Room(ears).hear(sound)
    assert room.commands() == []
    assert room.transcripts
    assert all(msg.end_utime - msg.start_utime <= 15_100_000 for msg in room.transcripts)
    room.hear(in_noise(say("walk like a zombie"), 30.0))
    assert [msg.skill for msg in room.commands()] == ["zombie"]


@needs_espeak
@pytest.mark.parametrize(
    ("voice", "text"),
    [("de", "morgen fahren wir mit dem zug ans meer"), ("fr", "il fait très beau aujourd'hui")],
)
def test_another_language_asks_for_nothing(ears, voice, text):
    room = Room(ears).hear(in_noise(say(text, voice), 30.0))
    assert room.commands() == []


@needs_espeak
def test_a_recogniser_set_to_another_language_says_nothing(ears):
    sound = in_noise(say("walk like a zombie"), 30.0)
    room = Room(ears, language="de").hear(sound)
    assert room.commands() == [] and all(not msg.text for msg in room.transcripts)


def test_empty_and_silent_sound_is_nothing(ears):
    room = Room(ears)
    for _ in range(20):
        room.feed(np.zeros(0, np.int16))
        room.pass_time(0.02)
    room.hear(np.zeros(2 * RATE, np.float32))
    assert (room.transcripts, room.intents, room.said) == ([], [], [])


@needs_espeak
def test_a_recogniser_that_breaks_costs_one_utterance(ears, capsys):
    class Breaks(Hears):
        def recognise(self, samples, language="en"):
            raise RuntimeError("no more memory")

    breaks = Breaks("")
    room = Room(ears, breaks).hear(in_noise(say("walk like a zombie"), 30.0))
    assert room.intents == []
    assert "no more memory" in capsys.readouterr().err
    breaks.recognise = Hears("do the twist").recognise
    room.hear(in_noise(say("do the twist"), 30.0))
    assert [msg.skill for msg in room.commands()] == ["twist"]


@needs_espeak
def test_early_segments_share_the_number_of_the_final_one():
    segmenter = Segmenter(Vad(), SegmentConfig(early_s=0.09))
    sound = in_noise(say("do the wave"), before_s=0.5, after_s=1.0)
    early, final = segmenter.push(sound, 0)[-2:]
    assert early.early and not final.early
    assert early.serial == final.serial
    assert final.closed_utime - early.closed_utime >= 100_000


@needs_espeak
def test_a_pause_is_ended_only_while_it_lasts_and_is_long_enough():
    segmenter = Segmenter(Vad(), SegmentConfig(early_s=0.09, sure_s=0.16))
    sound = in_noise(say("do the wave"), before_s=0.5, after_s=1.0)
    early = ended_at = None
    for at in range(0, len(sound), 512):
        for segment in segmenter.push(sound[at : at + 512], round(at / RATE * 1e6)):
            if segment.early:
                early = segment
                assert not segmenter.end(early.serial)  # 0.09 s are no 0.16 s
        if early and ended_at is None and segmenter.end(early.serial):
            ended_at = (at + 512) / RATE
            assert not segmenter.is_open and not segmenter.end(early.serial)
    assert 0.05 < ended_at - early.closed_utime * 1e-6 < 0.12


def test_guesses_are_used_once_and_only_for_their_own_pause():
    guesses = Guesses()
    assert guesses.end(1) == (False, None)
    guesses.begin(1)
    assert guesses.end(1) == (True, None)  # on its way
    assert guesses.arrive("text") == "text"
    guesses.begin(2)
    assert guesses.arrive("text") is None  # the pause is not over
    assert guesses.known() == [(2, "text")]
    assert guesses.end(2) == (True, "text")
    assert guesses.end(2) == (False, None)
    guesses.begin(3)
    assert guesses.arrive(None) is None and guesses.end(3) == (False, None)


def test_only_what_is_very_sure_and_of_several_words_ends_a_pause():
    def heard(text, confidence=0.99):
        return Recognition(text, confidence, "test", 0, tuple(text.split()))

    assert ends_a_pause(heard("walk like a zombie"))
    assert not ends_a_pause(heard("walk like a zombie", 0.9))
    assert not ends_a_pause(heard("walk like a zombie", float("nan")))
    for text in ("stop", "please stop it", "do the monkey", "salsa", ""):
        assert not ends_a_pause(heard(text)), text
