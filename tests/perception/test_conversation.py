"""Answers: true ones, short ones, and an honest one where nothing was understood."""

import shutil

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.perception.conversation import MAX_REPLY, Context, TableConversation, shorten
from downbeat.perception.errors import PerceptionError
from downbeat.perception.grounding import Grounder, IntentKind
from downbeat.perception.reply_table import NOT_UNDERSTOOD, QUESTIONS
from downbeat.perception.tts import EspeakVoice, SilentVoice, spoken
from downbeat.policies.manifest import load_skills

CONTEXT = Context(("Salsa", "Waltz", "Twist", "Disco", "Wave", "Walk"), "Salsa", "Neon Parade")


def test_every_question_that_is_listened_for_has_an_answer():
    table = TableConversation()
    for question in QUESTIONS:
        reply = table.reply(question, CONTEXT)
        assert reply.is_understood, question
        assert reply.text


def test_no_question_that_is_listened_for_is_a_command():
    grounder = Grounder(load_skills(), None)
    for question in QUESTIONS:
        assert grounder.ground(question).kind is IntentKind.CHAT, question


def test_answers_are_about_now():
    table = TableConversation()
    assert "Neon Parade" in table.reply("what song is this?", CONTEXT).text
    assert "do not know" in table.reply("what song is this?", Context()).text
    assert "salsa" in table.reply("What are you dancing", CONTEXT).text
    assert "standing" in table.reply("what are you doing", Context()).text
    assert "1 more" in table.reply("what can you do", CONTEXT).text


def test_what_is_not_understood_is_said_to_be_so():
    reply = TableConversation().reply("the square root of a fish", CONTEXT)
    assert (reply.text, reply.is_understood) == (NOT_UNDERSTOOD, False)


@given(st.text(max_size=3000))
def test_whatever_a_service_says_can_be_spoken(text):
    said = shorten(text)
    assert len(said) <= MAX_REPLY + 1
    assert said.isprintable()


def test_a_long_answer_ends_with_a_sentence():
    said = shorten("I can dance. " * 60)
    assert said.endswith("dance.") and len(said) <= MAX_REPLY


def test_without_a_voice_the_time_of_a_text_is_estimated():
    short, long = SilentVoice().say("Yes."), SilentVoice().say("I can dance to all of this music.")
    assert 0.3 < short.duration_s < long.duration_s < 5.0
    assert not len(long.samples)


@pytest.mark.skipif(shutil.which("espeak-ng") is None, reason="espeak-ng is not installed")
def test_espeak_speaks_as_long_as_it_says_and_about_as_long_as_was_estimated():
    voice = EspeakVoice()
    for text in ("Thank you very much.", "I recognise the music by its fingerprint, and dance."):
        said = voice.say(text)
        assert said.backend == "espeak-ng" and said.failure == ""
        assert said.duration_s == len(said.samples) / 16_000
        assert np.abs(said.samples[:400]).max() > 50, "silence at the start would delay the gesture"
        assert SilentVoice().say(text).duration_s == pytest.approx(said.duration_s, rel=0.4)


@pytest.mark.parametrize("raw", [b"", b"RIFF", b"no sound at all", b"\0" * 1000])
def test_what_is_no_sound_is_refused(raw):
    with pytest.raises(PerceptionError):
        spoken("hello", raw, "some voice")
