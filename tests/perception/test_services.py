"""Services that misbehave: bounded waits, one retry where it helps, the key in no text."""

import json
import time

import numpy as np
import pytest
from stand_in_server import stand_in

from downbeat.perception.conversation import ChatConversation, Context
from downbeat.perception.errors import PerceptionError
from downbeat.perception.recogniser_openai import OpenAIRecogniser
from downbeat.perception.reply_table import SERVICE_FAILED
from downbeat.perception.services import Service, ServiceError
from downbeat.perception.tts import ServiceVoice

KEY = "sk-very-secret"
SOUND = (0.1 * np.random.default_rng(0).standard_normal(16_000)).astype(np.float32)
BROKEN = ["401", "404", "500 500", "429 429", "hangup hangup", "garbage", "list", "slow", "drip"]


@pytest.fixture
def server():
    with stand_in() as made:
        yield made


def service(server, timeout_s=0.5):
    return Service(server.url, KEY, "MY_KEY", timeout_s)


def test_a_transcription_is_asked_for_as_the_protocol_says(server):
    heard = OpenAIRecogniser(server.url, "some-model", KEY, "MY_KEY").recognise(SOUND, "en-GB")
    assert (heard.text, heard.failure) == ("do the wave", "")
    path, headers, body = server.seen[0]
    assert path == "/v1/audio/transcriptions"
    assert headers["Authorization"] == f"Bearer {KEY}"
    assert headers["Content-Type"].startswith("multipart/form-data; boundary=")
    assert b'name="model"\r\n\r\nsome-model' in body
    assert b'name="language"\r\n\r\nen\r\n' in body
    assert b"RIFF" in body and b'filename="utterance.wav"' in body


def test_a_streamed_transcription_is_read_to_its_end(server):
    server.script += ["stream"]
    assert OpenAIRecogniser(server.url, "m", "", "K").recognise(SOUND).text == "do the wave"


@pytest.mark.parametrize("how", BROKEN)
def test_a_recogniser_that_cannot_answer_says_why_and_when(server, how):
    server.script += how.split()
    begin = time.monotonic()
    heard = OpenAIRecogniser(server.url, "m", KEY, "MY_KEY", 0.5).recognise(SOUND)
    assert time.monotonic() - begin < 1.2
    assert heard.text == "" and heard.failure
    assert KEY not in heard.failure
    assert "MY_KEY" in heard.failure if how == "401" else True


@pytest.mark.parametrize("how", ["500", "429", "hangup"])
def test_what_a_second_try_can_mend_is_tried_twice(server, how):
    server.script += [how]
    assert OpenAIRecogniser(server.url, "m", "", "K", 2.0).recognise(SOUND).text == "do the wave"
    assert len(server.seen) == 2


def test_a_refused_key_is_not_sent_again(server):
    server.script += ["401"]
    with pytest.raises(ServiceError, match="MY_KEY"):
        service(server).post_json("/chat/completions", {})
    assert len(server.seen) == 1


def test_an_endless_answer_is_cut(server):
    server.script += ["huge", "huge"]
    with pytest.raises(ServiceError):
        service(server, 5.0).post_json("/chat/completions", {})


def test_nobody_listening_is_an_error_in_time():
    begin = time.monotonic()
    with pytest.raises(ServiceError, match="cannot be reached"):
        Service("http://127.0.0.1:9/v1", timeout_s=1.0).post_json("/x", {})
    assert time.monotonic() - begin < 1.2


def test_a_key_is_in_no_representation():
    assert KEY not in repr(Service("http://127.0.0.1:9/v1", KEY))


@pytest.mark.parametrize("url", ["", "ftp://x", "http://", "api.openai.com/v1"])
def test_what_is_no_url_is_refused(url):
    with pytest.raises(PerceptionError, match="http"):
        Service(url)


def test_a_chat_knows_the_robot_and_what_was_said_before(server):
    chat = ChatConversation(service(server), memory=4)
    server.text = "I am a robot."
    assert chat.reply("who are you", Context(("Wave",), "", "Neon Parade")).text == "I am a robot."
    chat.reply("really", Context())
    sent = [json.loads(body)["messages"] for _, _, body in server.seen]
    assert "Wave" in sent[0][0]["content"] and "Neon Parade" in sent[0][0]["content"]
    assert [one["content"] for one in sent[1][1:]] == ["who are you", "I am a robot.", "really"]
    for _ in range(5):
        chat.reply("again", Context())
    assert len(json.loads(server.seen[-1][2])["messages"]) == 6


@pytest.mark.parametrize("how", [*BROKEN, "no_choices"])
def test_a_chat_that_fails_is_answered_by_the_table_or_honestly(server, how):
    chat = ChatConversation(service(server))
    server.script += how.split()
    known = chat.reply("who are you", Context())
    assert "Downbeat" in known.text and known.failure and KEY not in known.failure
    server.script.clear()
    server.script += how.split()
    assert chat.reply("what is the capital of Peru", Context()).text == SERVICE_FAILED


@pytest.mark.parametrize("how", [*BROKEN, "empty"])
def test_a_voice_that_fails_is_replaced(server, how):
    server.script += how.split()
    spoken = ServiceVoice(service(server)).say("Hello there.")
    assert spoken.failure and spoken.backend in ("espeak-ng", "text")
    assert spoken.duration_s > 0.3


def test_a_voice_is_played_at_the_speakers_rate_and_for_its_true_time(server):
    spoken = ServiceVoice(service(server)).say("Hello.")
    assert spoken.backend == "openai" and spoken.failure == ""
    assert spoken.duration_s == pytest.approx(0.5, abs=0.02)
    assert len(spoken.samples) == round(spoken.duration_s * 16_000)


@pytest.mark.parametrize(
    "sound",
    [np.zeros(16_000, np.float32), np.zeros(0, np.float32), np.full(16_000, np.nan, np.float32)],
    ids=["silence", "nothing", "nan"],
)
def test_what_is_no_sound_is_not_sent(server, sound):
    assert OpenAIRecogniser(server.url, "m", "", "K").recognise(sound).text == ""
    assert not server.seen


def test_a_monologue_is_cut_before_it_is_sent(server):
    long = np.tile(SOUND, 40)
    OpenAIRecogniser(server.url, "m", "", "K").recognise(long)
    assert len(server.seen[0][2]) < 31 * 32_000
