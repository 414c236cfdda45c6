"""The stage scene: music, a command over it, a question, and the dance that comes back in phase."""

import json
import subprocess
import sys

import pytest

from downbeat.perception.errors import PerceptionError
from downbeat.perception.sentence_model import packaged_folder
from downbeat.perception.vad import packaged_model
from downbeat.tools.onstage import has_espeak

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not has_espeak(), reason="espeak-ng, which speaks the lines, is missing"),
]


def test_the_robot_obeys_answers_and_resumes(tmp_path):
    pytest.importorskip("pocketsphinx")
    try:
        packaged_model(), packaged_folder()
    except PerceptionError as error:
        pytest.skip(str(error))
    command = [sys.executable, "-m", "downbeat.tools.cli", "demo", "--scene", "onstage"]
    command += ["--lockstep", "--no-video", "--json", "--runs", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    metrics = json.loads(done.stdout.strip().splitlines()[-1])
    speech = metrics["speech"]
    assert all(row["good"] for row in speech["utterances"]), speech["utterances"]
    assert metrics["falls"] == 0 and metrics["safety_trips"] == 0
    assert metrics["replay_equal"]
    assert speech["resumed"] == 3
    assert speech["gestures"]["start_skew_ms"]["max"] <= 100
    assert speech["gestures"]["end_skew_ms"]["max"] <= 100
    assert metrics["beat_phase_error_ms"]["p95"] < 20
    assert done.returncode == 0
