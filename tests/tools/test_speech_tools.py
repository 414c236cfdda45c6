"""Bench and timeline of speech: what is counted, what is drawn."""

import json
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from downbeat.lcm_types import speech_t
from downbeat.perception.recogniser_openai import OpenAIRecogniser
from downbeat.perception.recognisers import RecogniserConfig
from downbeat.perception.speech_config import (
    ChatConfig,
    SpeechConfig,
    VoiceConfig,
    make_conversation,
    make_voice,
)
from downbeat.perception.speech_node import Ears
from downbeat.perception.tts import SilentVoice
from downbeat.policies.manifest import load_skills
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.tools import speech_parts
from downbeat.tools.bench_speech import Said, _latency
from downbeat.tools.commands.evaluate import Speech
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_speech import BUNDLED_UTTERANCES, eval_speech
from downbeat.tools.eval_spoken import _share
from downbeat.tools.rehearse import run_rehearse
from downbeat.tools.speech_parts import introduction
from downbeat.tools.speech_stand_in import stand_in_service
from downbeat.tools.timeline_speech import _fit, said_lines

ROOT = Path(__file__).resolve().parents[2]


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


def introduced(chat="table", **settings):
    config = SpeechConfig(**{"voice": VoiceConfig(backend="text"), **settings})
    ears = Ears(
        None,
        SimpleNamespace(name=config.recogniser.backend),
        None,
        make_conversation(ChatConfig(backend=chat)),
        make_voice(config.voice),
    )
    return introduction(config, ears, load_skills())


def test_speech_introduces_itself_in_a_line():
    count = len(load_skills()) - 2  # all but stand, which is a stop, and talk
    assert introduced() == (
        "speech hears AUDIO_CHUNK of listener or source by pocketsphinx (en), "
        f"asks for {count} skills or a stop on SPEECH_INTENT, "
        "answers from the table on SPEECH as text, with 'talk'"
    )
    service = VoiceConfig(backend="openai", output="robot:eth0", gesture="")
    said = introduced(
        language="", skills=("wave",), recogniser=RecogniserConfig("openai"), voice=service,
        keep_recordings="heard",
    )  # fmt: skip
    for words in ("by openai (any language)", "asks for 1 skill or", "by openai on robot:eth0;"):
        assert words in said
    assert said.endswith("keeps what it hears in heard") and "with '" not in said
    assert introduced(chat="none").endswith("answers nothing")


def test_the_speech_process_introduces_itself_when_it_is_ready(tmp_path, monkeypatch):
    ears = Ears(None, SimpleNamespace(name="stand-in"), None, None, SilentVoice())
    monkeypatch.setattr(speech_parts, "make_ears", lambda config, skills: ears)
    config = SpeechConfig(voice=VoiceConfig(backend="text", output="none"))
    said = []
    bus = MemqHub().endpoint("speech", SimClock(SIM_EPOCH_UTIME))
    node = speech_parts.build_speech(config, load_skills(), bus, tmp_path, 0, True, {}, said.append)
    node.close()
    assert [line.split(" by ")[1].split(" ")[0] for line in said] == ["stand-in"]


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("test\tcomand\twave\tdo the wave", "set.tsv:3 has the kind 'comand'; valid are again, "),
        ("test\trequest\twaves\tdo the wave", "set.tsv:3 has the expected 'waves'; valid are -, "),
        ("test\tchat\tnone\tnice day", "set.tsv:3 has the expected 'none'"),
        ("test\trequest\ttalk\ttalk", "set.tsv:3 has the expected 'talk'"),  # never by voice
        ("test\trequest\twave", "set.tsv:3 is not half, kind, expected, text"),
    ],
)
def test_a_row_that_is_none_is_named_and_not_counted(tmp_path, row, said):
    path = tmp_path / "set.tsv"
    path.write_text(f"half\tkind\texpected\ttext\ntest\tresume\tresume\tgo on\n{row}\n")
    with pytest.raises(ToolError, match=re.escape(said)):
        eval_speech(path, "all", True, True)


def test_the_bundled_set_is_found_from_anywhere_and_is_in_the_wheel(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Speech(half="tune", letters_only=True, json=True).run()
    assert json.loads(capsys.readouterr().out)["n"] == 160
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    patterns = project["tool"]["setuptools"]["package-data"]["downbeat.tools"]
    folder = BUNDLED_UTTERANCES.parent
    assert BUNDLED_UTTERANCES in [path for pattern in patterns for path in folder.glob(pattern)]


def test_a_long_line_is_cut_at_a_word():
    assert _fit("walk like a zombie", 40) == "walk like a zombie"
    assert _fit("walk like a zombie", 12) == "walk like…"
    assert _fit("walk like a zombie", 3) == ""


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("speech", 'langauge = "en"\n', "speech.toml:langauge is not known"),
        ("speech", 'skills = ["kpopp"]\n', "Speech cannot trigger 'kpopp'"),
        ("speech", 'skills = ["wave", "talk"]\n', "'talk', which the robot does when it answers"),
        ("hearing", '[conductor]\nunknown = "dans"\n', "hearing.toml:conductor.unknown is 'dans'"),
    ],
)
def test_a_rehearsal_says_what_the_show_would_stumble_over(tmp_path, capsys, name, text, said):
    (tmp_path / "cat").mkdir()
    (tmp_path / f"{name}.toml").write_text(text)
    show = f'tracks = "cat"\nindex = "i"\naudio = "x.wav"\n{name} = "{name}.toml"\n'
    (tmp_path / "show.toml").write_text(show)
    assert run_rehearse(tmp_path / "show.toml", 8, False) == 2
    assert said in capsys.readouterr().err
