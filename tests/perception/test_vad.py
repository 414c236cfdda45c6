"""Voice activity: what counts as voice, and that a stream hears what a whole chunk hears."""

import subprocess
import sys

import numpy as np
import onnxruntime
import pytest
from spoken import in_noise, needs_espeak, say

from downbeat.perception.errors import PerceptionError
from downbeat.perception.vad import Vad, VadStream, packaged_model, voiced_fraction


@pytest.fixture(scope="module")
def vad():
    return Vad()


def rough_voice(seconds=3.0, seed=0):
    """A buzz with moving formants: no speech, but it moves the model's state."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 16_000)) / 16_000
    buzz = np.sign(np.sin(2 * np.pi * 120 * t)) * (1 + np.sin(2 * np.pi * 4 * t)) * 0.1
    return (buzz + 0.01 * rng.standard_normal(len(t))).astype(np.float32)


def test_pieces_of_any_length_give_the_probabilities_of_the_whole(vad):
    samples = rough_voice()[: 90 * 512]
    whole = vad.probabilities(samples)
    rng = np.random.default_rng(3)
    stream, found, at = VadStream(vad), [], 0
    while at < len(samples):
        length = int(rng.integers(1, 3000))
        found.append(stream.push(samples[at : at + length]))
        at += length
    np.testing.assert_allclose(np.concatenate(found), whole, atol=1e-6)
    assert np.ptp(whole) > 0.01  # it is not a constant


def test_the_sequence_model_says_what_the_frame_model_says(vad):
    samples = rough_voice(2.0)
    session = onnxruntime.InferenceSession(
        str(packaged_model().parent / "silero_vad_16k_op15.onnx")
    )
    state, context, expected = np.zeros((2, 1, 128), np.float32), np.zeros(64, np.float32), []
    for frame in samples[: len(samples) // 512 * 512].reshape(-1, 512):
        fed = {"input": np.hstack((context, frame))[None], "state": state, "sr": np.int64(16_000)}
        output, state = session.run(None, {k: np.asarray(v) for k, v in fed.items()})
        context = frame[-64:]
        expected.append(output[0, 0])
    found = vad.probabilities(samples)
    np.testing.assert_allclose(found[: len(expected)], expected, atol=1e-4)


def test_a_chunk_gives_one_probability_per_started_frame(vad):
    assert [len(vad.probabilities(np.zeros(n, np.float32))) for n in (0, 1, 512, 513)] == [
        0,
        1,
        1,
        2,
    ]


@needs_espeak
def test_speech_is_voiced_and_noise_tones_and_silence_are_not(vad):
    rng = np.random.default_rng(0)
    t = np.arange(5 * 16_000) / 16_000
    speech = in_noise(say("please show me how the robot dances"), before_s=0, after_s=0)
    assert voiced_fraction(vad.probabilities(speech)) > 0.6
    for other in (
        np.zeros(len(t)),
        0.05 * rng.standard_normal(len(t)),
        0.1 * np.sin(2 * np.pi * 440 * t),
    ):
        assert voiced_fraction(vad.probabilities(other.astype(np.float32))) < 0.05


def test_torch_is_never_imported():
    code = "import sys, downbeat.perception.vad as v; v.Vad(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0


def test_a_file_that_is_no_model_is_named(tmp_path):
    (tmp_path / "x.onnx").write_bytes(b"no model")
    with pytest.raises(PerceptionError, match="x.onnx"):
        Vad(tmp_path / "x.onnx")
