"""Speech without music, through listener, speech, conductor, control and plant."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import soundfile
import soxr

from downbeat.catalog.setlist import SetList
from downbeat.perception.errors import PerceptionError
from downbeat.perception.sentence_model import packaged_folder
from downbeat.perception.vad import packaged_model
from downbeat.policies.manifest import load_skills
from downbeat.tools.demo import bundled_library
from downbeat.tools.eval_mashup import write_show
from downbeat.tools.eval_spoken import HEARING, HEARING_NAME, SPEECH_NAME, Level, summary
from downbeat.tools.mashup import SAMPLE_RATE_HZ, Mashup
from downbeat.tools.onstage import has_espeak, speak
from downbeat.tools.replay import replay_equal
from downbeat.tools.report import report
from downbeat.tools.run_lockstep import run_lockstep
from downbeat.tools.runlog import LOG_NAME, read_run

pytest.importorskip("pocketsphinx")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """The bundled catalogue; nothing of it is played."""
    from downbeat.catalog.tracks import BUNDLED_TRACKS, load_tracks

    try:
        packaged_model(), packaged_folder()
    except PerceptionError as error:
        pytest.skip(str(error))
    folder = tmp_path_factory.mktemp("library")
    return bundled_library(load_tracks(BUNDLED_TRACKS, load_skills()), folder / "catalog")


def perform(folder, library, samples, rows, hold_s=3.0):
    """Play a sound through the whole chain in lockstep; returns the metrics."""
    shutil.copytree(library.folder, folder / "catalog")
    truth = {
        "version": 1, "sample_rate_hz": SAMPLE_RATE_HZ,
        "duration_s": len(samples) / SAMPLE_RATE_HZ, "announced": False,
        "segments": [], "sections": [], "beat_grids": {}, "speech": rows, "seed": 0,
    }  # fmt: skip
    (folder / SPEECH_NAME).write_text(f"hold_s = {hold_s}\n", encoding="utf-8")
    (folder / HEARING_NAME).write_text(HEARING, encoding="utf-8")
    sound = Mashup(samples.astype(np.float32), SetList(()), truth)
    here = type(library)(library.tracks, library.recordings, folder / "catalog")
    show = write_show(folder, sound, here, 0, speech=SPEECH_NAME, hearing=HEARING_NAME)
    run_lockstep(show, folder, truth["duration_s"])
    return report(folder, replay_equal(folder))


def script(*lines):
    """Return the sound of (text, expected, pause after it [s]), and the truth about it."""
    parts, rows, at = [np.zeros(SAMPLE_RATE_HZ, np.float32)], [], 1.0
    for text, expected, pause_s in lines:
        sound = speak(text, "en-us", SAMPLE_RATE_HZ)
        end = at + len(sound) / SAMPLE_RATE_HZ
        rows.append({"start_s": at, "end_s": end, "text": text, "expected": expected})
        parts += [0.3 * sound, np.zeros(round(pause_s * SAMPLE_RATE_HZ), np.float32)]
        at = end + pause_s
    return np.concatenate(parts), rows


@pytest.mark.slow
@pytest.mark.skipif(not has_espeak(), reason="espeak-ng, which speaks the lines, is missing")
def test_a_show_of_words_alone_is_obeyed_answered_and_ends_in_stand(library, tmp_path):
    sound, rows = script(
        ("walk like a zombie", "zombie", 6.0),
        ("we need two more chairs in the front row", "", 1.5),
        ("who are you", "answer", 7.0),
        ("dance like a robot", "robot", 2.0),
        ("stop dancing", "stop", 2.5),
    )
    metrics = perform(tmp_path, library, sound, rows)
    speech = metrics["speech"]
    assert all(row["good"] for row in speech["utterances"]), speech["utterances"]
    assert (metrics["falls"], metrics["safety_trips"], metrics["replay_equal"]) == (0, 0, True)
    gestures = speech["gestures"]
    assert gestures["answers"] == 1 and gestures["without"] == 0
    assert gestures["start_skew_ms"]["max"] <= 100 and gestures["end_skew_ms"]["max"] <= 100
    assert read_run(tmp_path / LOG_NAME).control.executed[-1] == "stand"


@pytest.mark.slow
def test_real_recordings_of_speech_trigger_nothing(library, tmp_path):
    folder = Path(__file__).resolve().parents[3] / "shared" / "audio" / "speech"
    if not folder.is_dir():
        pytest.skip("no ../shared/audio/speech beside this checkout")
    parts = [np.zeros(SAMPLE_RATE_HZ, np.float32)]
    for path in sorted(folder.iterdir()):
        samples, rate = soundfile.read(path, dtype="float32", always_2d=True)
        parts += [soxr.resample(samples.mean(axis=1), rate, SAMPLE_RATE_HZ), parts[0]]
    metrics = perform(tmp_path, library, np.concatenate(parts), [])
    log = read_run(tmp_path / LOG_NAME)
    assert log.events["TRANSCRIPT"], "nothing was heard at all"
    assert [(m.skill, m.text) for m in log.events["SPEECH_INTENT"]] == []
    assert log.events["SPEECH"] == []
    assert set(log.control.executed[log.control.utime > log.control.utime[0] + 4_000_000]) == {
        "stand"
    }
    assert metrics["falls"] == 0


def test_the_voices_and_the_other_sentences_are_new_to_the_recogniser():
    from downbeat.tools import recogniser_sentences as known
    from downbeat.tools.spoken_lines import OTHERS, VOICES

    voices = {*known.ADAPTATION_VOICES, *known.CALIBRATION_VOICES, *known.TEST_VOICES}
    assert not voices & set(VOICES)
    assert not {*known.CALIBRATION_SENTENCES, *known.TEST_SENTENCES} & set(OTHERS)


def test_the_summary_fails_what_misses_a_target():
    good = Level("clean", commands=20, obeyed=18, others=20)
    good.start_skew_ms, good.end_skew_ms = [10.0], [90.0]
    assert summary([good])["good"]
    json.dumps(summary([good]))
    for name, value in (("obeyed", 17), ("false_triggers", 1), ("falls", 1)):
        bad = Level("clean", commands=20, obeyed=18, others=20)
        bad.start_skew_ms, bad.end_skew_ms = [10.0], [90.0]
        setattr(bad, name, value)
        assert not summary([bad])["good"], name
    late = Level("clean", commands=20, obeyed=18, others=20)
    late.start_skew_ms, late.end_skew_ms = [10.0], [150.0]
    assert not summary([late])["good"]
    assert not summary([Level("10", commands=20, obeyed=15)])["good"]
