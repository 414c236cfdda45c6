"""The embedded recogniser: hears commands, keeps silent about everything else, bounds its work."""

import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
import soundfile
import soxr
from spoken import RATE, in_noise, needs_espeak, say

from downbeat.perception.acoustic_model import load_acoustic_model, packaged_folder
from downbeat.perception.cepstra import cepstra, mel_spectrum, streams, without_noise
from downbeat.perception.errors import PerceptionError
from downbeat.perception.phone_network import Chain, Network, best_states, search
from downbeat.perception.recogniser_pocketsphinx import (
    FEATURES,
    MAX_COMMAND_S,
    PocketsphinxRecogniser,
    load_calibration,
)
from downbeat.perception.segments import Segmenter
from downbeat.perception.vad import Vad
from downbeat.policies.manifest import load_skills
from downbeat.tools.speech_parts import sayable

pytest.importorskip("pocketsphinx")
SPEECH = Path(__file__).resolve().parents[3] / "shared" / "audio" / "speech"


@pytest.fixture(scope="module")
def recogniser():
    return PocketsphinxRecogniser(sayable(load_skills()))


@pytest.fixture(scope="module")
def model():
    return load_acoustic_model(packaged_folder() / "en-us")


def threshold(recogniser):
    return recogniser.calibration.by_voice["synthetic"].threshold


@needs_espeak
@pytest.mark.parametrize(
    ("text", "voice"),
    [
        ("walk like a zombie", "en-us"),
        ("please do the twist", "en-gb"),
        ("stop dancing", "en-us+f2"),
        ("saturday night fever", "en-gb-scotland"),
        ("what can you do", "en-us"),
    ],
)
def test_what_may_be_asked_for_is_heard_in_noise(recogniser, text, voice):
    found = recogniser.recognise(in_noise(say(text, voice)))
    assert found.text == text
    assert found.confidence >= threshold(recogniser)
    assert found.words == tuple(text.split())


@needs_espeak
@pytest.mark.parametrize(
    "text",
    [
        "the museum opens at ten in the morning",
        "my laptop is very slow today",
        "paris is the capital of france",
        "there is a bakery around the corner",
    ],
)
def test_other_sentences_are_nothing(recogniser, text):
    found = recogniser.recognise(in_noise(say(text, "en-us")))
    assert found.text == "" and not found.words
    assert math.isnan(found.confidence) or found.confidence < threshold(recogniser)


@needs_espeak
def test_a_negation_is_heard(recogniser):
    found = recogniser.recognise(in_noise(say("don't do the zombie")))
    assert "don't" in found.words or "not" in found.words or not found.text


def test_noise_and_broken_sound_are_nothing(recogniser):
    rng = np.random.default_rng(0)
    noise = 0.1 * rng.standard_normal(2 * RATE).astype(np.float32)
    click = np.zeros(RATE, np.float32)
    click[5000] = 1.0
    broken = np.full(RATE, np.nan, np.float32)
    sounds = (noise, click, broken, np.zeros(RATE), np.zeros(0), noise[:200], 9.0 * noise)
    for sound in sounds:
        assert recogniser.recognise(np.asarray(sound, np.float32)).text == ""


@needs_espeak
def test_digital_silence_around_a_command_does_no_harm(recogniser):
    sound = np.pad(say("walk like a zombie"), (RATE // 2, RATE // 2))
    assert recogniser.recognise(sound).text == "walk like a zombie"


@needs_espeak
def test_another_language_or_a_monologue_is_not_decoded(recogniser):
    sound = in_noise(say("walk like a zombie"))
    assert recogniser.recognise(sound, language="de").text == ""
    long = np.tile(sound, math.ceil(MAX_COMMAND_S * RATE / len(sound)) + 1)
    found = recogniser.recognise(long)
    assert found.text == "" and math.isnan(found.confidence)


@needs_espeak
def test_phrases_of_one_meaning_do_not_compete():
    sound = in_noise(say("raise the roof"))
    calibration = load_calibration()
    margin = FEATURES.index("margin")
    two = PocketsphinxRecogniser({"raise the roof": "pump", "raise a roof": "other"}, calibration)
    one = PocketsphinxRecogniser({"raise the roof": "pump", "raise a roof": "pump"}, calibration)
    assert one.score(sound).features[margin] > two.score(sound).features[margin]


@needs_espeak
def test_synthetic_voices_are_heard_by_their_own_model_and_people_are_not(recogniser):
    assert recogniser.score(in_noise(say("the train is late", "en-gb-x-rp"))).voice == "synthetic"
    files = sorted(SPEECH.glob("*.ogg"))
    if not files:
        pytest.skip("no ../shared/audio/speech beside this checkout")
    samples, rate = soundfile.read(files[0], dtype="float32", frames=3 * 48000)
    samples = soxr.resample(samples, rate, RATE).astype(np.float32)
    assert recogniser.score(samples).voice == "people"


def test_real_speech_triggers_nothing(recogniser):
    files = sorted(SPEECH.glob("*.ogg"))
    if not files:
        pytest.skip("no ../shared/audio/speech beside this checkout")
    heard = []
    for file in files:
        samples, rate = soundfile.read(file, dtype="float32")
        samples = soxr.resample(samples, rate, RATE).astype(np.float32)
        ears = Segmenter(Vad())
        found = ears.push(samples, 0) + ears.flush()
        heard += [recogniser.recognise(one.samples).text for one in found]
    assert len(heard) >= 5
    assert not any(heard), heard


@needs_espeak
def test_cepstra_are_those_of_the_package(model):
    import pocketsphinx

    sound = in_noise(say("walk like a zombie"))
    parameters = (packaged_folder() / "en-us" / "feat.params").read_text()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "feat.params"
        file.write_text(parameters.replace("-remove_noise yes", "-remove_noise no"))
        decoder = pocketsphinx.Decoder(
            lm=None, loglevel="FATAL", mfclogdir=folder, featparams=str(file)
        )
        decoder.add_allphone_file("phones", None)
        decoder.activate_search("phones")
        decoder.start_utt()
        pcm = (sound * 32767).astype("<i2")
        decoder.process_raw(pcm.tobytes(), no_search=False, full_utt=True)
        decoder.end_utt()
        raw = next(Path(folder).glob("*.mfc")).read_bytes()
    theirs = np.frombuffer(raw, ">f4", offset=4).reshape(-1, 13)
    ours = cepstra(mel_spectrum(pcm.astype(np.float32) / 32768))
    theirs = theirs[: len(ours)] - theirs.mean(axis=0)
    for order in range(13):
        assert np.corrcoef(ours[:, order], theirs[:, order])[0, 1] > 0.9999, order


@needs_espeak
def test_senones_of_what_is_said_are_likely(model):
    likelihoods = model.log_likelihoods(streams(cepstra(mel_spectrum(in_noise(say("see"), 40.0)))))
    best = model.phone_of_senone[likelihoods.argmax(axis=1)]
    heard = [model.phones[number] for number in best]
    assert "S" in heard and "IY" in heard
    assert heard.index("S") < len(heard) - 1 - heard[::-1].index("IY")


def test_the_search_agrees_with_the_best_states_of_its_chain(model):
    rng = np.random.default_rng(4)
    scores = rng.standard_normal((40, 6)).astype(np.float32)
    phones = [5] * 3 + [9] * 3
    chain = Chain(range(6), phones, 0, 1, -1.0, "word")
    found = search(Network(model, [chain]), scores)
    kind = np.arange(6) % 3
    stay, leave = model.stay[phones, kind], model.leave[phones, kind]
    states = best_states(scores, stay, leave)
    steps = np.diff(states)
    assert set(steps) <= {0, 1} and states[0] == 0 and states[-1] == 5
    total = scores[np.arange(40), states].sum() - 1.0 + leave[-1]
    total += np.where(steps == 0, stay[states[:-1]], leave[states[:-1]]).sum()
    assert found.ends[-1, 0] == pytest.approx(total, abs=1e-3)
    (part,) = found.path(40, 1)
    assert (part.label, part.first, part.end) == ("word", 0, 40)


def test_steady_noise_is_attenuated_and_speech_is_not():
    rng = np.random.default_rng(2)
    noise = 0.002 * rng.standard_normal(2 * RATE)
    tone = np.zeros(2 * RATE)
    tone[RATE // 2 : RATE] = 0.3 * np.sin(2 * np.pi * 1000 * np.arange(RATE // 2) / RATE)
    before = mel_spectrum((noise + tone).astype(np.float32))
    after = without_noise(before)
    loud = before.mean(axis=1) > 0.5 * before.mean(axis=1).max()
    band = before[loud].mean(axis=0).argmax()
    assert 10 * np.log10(after[loud, band].mean() / before[loud, band].mean()) > -0.5
    quiet = 10 * np.log10(after[:40, band].mean() / before[:40, band].mean())
    assert quiet < -3.0 or after[:40, band].mean() <= 2e-3 * before.mean()


def test_files_that_do_not_fit_are_refused(tmp_path, model):
    with pytest.raises(PerceptionError, match="is no calibration"):
        load_calibration(tmp_path / "none.json")
    with pytest.raises(PerceptionError, match="is no adaptation"):
        model.adapted(tmp_path / "none.npz")
    with pytest.raises(PerceptionError, match="is no acoustic model"):
        load_acoustic_model(tmp_path)
    (tmp_path / "mdef").write_bytes(b"BMDF" + bytes(100))
    with pytest.raises(PerceptionError, match="is no acoustic model"):
        load_acoustic_model(tmp_path)


@pytest.mark.slow
@needs_espeak
def test_test_voices_are_obeyed_and_other_sentences_are_not():
    from downbeat.tools.calibrate_recogniser import evaluate

    found = evaluate(snr_db=20.0, share=4)
    assert found["right"] >= 0.85, found
    assert found["false_accepts"] <= 0.06, found
    assert found["wrong"] <= 0.08, found
