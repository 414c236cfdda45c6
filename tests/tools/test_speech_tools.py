"""Bench and timeline of speech: what is counted, what is drawn."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from downbeat.lcm_types import speech_t
from downbeat.perception.recogniser_openai import OpenAIRecogniser
from downbeat.runtime.errors import DownbeatError
from downbeat.tools.bench_speech import Said, _latency
from downbeat.tools.eval_spoken import _share
from downbeat.tools.rehearse import run_rehearse
from downbeat.tools.speech_stand_in import stand_in_service
from downbeat.tools.timeline_speech import _fit, said_lines


def test_a_request_counts_for_the_utterance_before_it():
    said = [Said(0, 1_000_000), Said(3_000_000, 4_000_000), Said(6_000_000, 7_000_000)]
    found = _latency(said, [1_300_000, 4_400_000], [1_250_000], [90.0])
    assert (found["utterances"], found["asked"]) == (3, 2)
    assert found["latency_ms"]["p50"] == 350.0 and found["latency_ms"]["max"] == 400.0
    assert found["closing_ms"]["max"] == 250.0


def test_the_stand_in_waits_and_answers_as_the_protocol_says():
    with stand_in_service("do the wave", 0.1) as url:
        heard = OpenAIRecogniser(url, "any", "", "K", 5.0).recognise(np.ones(16_000, np.float32))
    assert (heard.text, heard.failure) == ("do the wave", "")
    assert heard.compute_us >= 100_000


def test_an_interval_holds_its_share_and_narrows():
    few, many = _share(9, 10), _share(90, 100)
    assert few["low"] < 0.9 < few["high"] and few["low"] < many["low"]
    assert _share(0, 60)["high"] < 0.065


def answer(state, utterance_id, utime, start=0):
    msg = speech_t()
    msg.state, msg.utterance_id, msg.text = state, utterance_id, "I can dance."
    msg.header.utime, msg.start_utime = utime, start
    return msg


def test_lines_show_what_became_of_what_was_said():
    raw = {
        "speech": [
            {"start_s": 1.0, "end_s": 2.0, "text": "do the twist", "expected": "twist"},
            {"start_s": 5.0, "end_s": 6.0, "text": "who are you", "expected": "answer"},
        ]
    }
    rows = [
        {"text": "do the twist", "expected": "twist", "found": "wave", "good": False,
         "onset_s": None},
        {"text": "who are you", "expected": "answer", "found": "", "good": True, "onset_s": None},
    ]  # fmt: skip
    events = {
        "TRANSCRIPT": [],
        "SPEECH": [
            answer(speech_t.STARTED, 1, 7_000_000, 7_000_000),
            answer(speech_t.FINISHED, 1, 9_000_000),
        ],
    }
    log = SimpleNamespace(events=events)
    said, answers = said_lines(log, raw, {"speech": {"utterances": rows}}, 0)
    assert [line.note for line in said] == ["wave", "answered"]
    assert said[0].colour != said[1].colour
    assert [(line.start_s, line.end_s) for line in answers] == [(7.0, 9.0)]


def test_a_long_line_is_cut_at_a_word():
    assert _fit("walk like a zombie", 40) == "walk like a zombie"
    assert _fit("walk like a zombie", 12) == "walk like…"
    assert _fit("walk like a zombie", 3) == ""


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("speech", 'langauge = "en"\n', "speech.toml:langauge is not known"),
        ("speech", 'skills = ["kpopp"]\n', "Speech cannot trigger 'kpopp'"),
        ("hearing", '[conductor]\nunknown = "dans"\n', "hearing.toml:conductor.unknown is 'dans'"),
    ],
)
def test_a_rehearsal_says_what_the_show_would_stumble_over(tmp_path, name, text, said):
    (tmp_path / "cat").mkdir()
    (tmp_path / f"{name}.toml").write_text(text)
    show = f'tracks = "cat"\nindex = "i"\naudio = "x.wav"\n{name} = "{name}.toml"\n'
    (tmp_path / "show.toml").write_text(show)
    with pytest.raises(DownbeatError, match=re.escape(said)):
        run_rehearse(tmp_path / "show.toml", 8, False)
