"""The router: its rule, what it makes of real sound, and that a stream is heard as one piece."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
import soxr
from hypothesis import given
from hypothesis import strategies as st
from spoken import in_noise, needs_espeak, say
from synthetic_music import RATE as MUSIC_RATE
from synthetic_music import make_music

from downbeat.perception.errors import PerceptionError
from downbeat.perception.router import (
    MUSIC,
    SKIP,
    SPEECH,
    RouterConfig,
    paper_route,
    route,
)
from downbeat.perception.router_choice import make_router
from downbeat.perception.router_embedded import WEIGHTS, EmbeddedRouter, RouterNet
from downbeat.perception.router_features import MIN_FRAMES, NUM_FEATURES, window_features
from downbeat.perception.router_frames import NO_FRAMES, FrameStream
from downbeat.perception.source import load_recording
from downbeat.perception.vad import Vad
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_router import RULES, RouterOptions, RouterStudy, Row, eval_router
from downbeat.tools.router_fit import FitOptions, fit
from downbeat.tools.router_sounds import active_rms, over_music, truth_over_music

RATE = 16_000
CONFIG = RouterConfig()
share = st.one_of(st.floats(0.0, 1.0), st.just(math.nan))


@pytest.fixture(scope="module")
def vad():
    return Vad()


@pytest.fixture
def router(vad):
    return EmbeddedRouter(vad=vad)


def heard(router, samples, block=800, first_utime=1_000_000_000_000_000):
    """Judge the end of a sound that comes in blocks."""
    router.reset()
    for first in range(0, len(samples), block):
        router.hear(samples[first : first + block], first_utime + first * 1_000_000 // RATE)
    return router.judge(0.0)


def tune(seed=1, seconds=6.0):
    made = soxr.resample(make_music(seed, seconds), MUSIC_RATE, RATE)
    return (0.1 * made / np.sqrt(np.mean(made**2))).astype(np.float32)


def voice(seconds=6.0):
    spoken = say("would you please come over here and tell me what we are going to do today")
    return np.resize(in_noise(spoken, 30.0, 0.1, 0.1), round(seconds * RATE))


# The rule


@given(share, share, share, st.floats(0.0, 1.0))
def test_every_window_gets_exactly_one_label(p_music, p_speech, v_frac, evidence):
    for rule in (route, paper_route):
        assert rule(p_music, p_speech, v_frac, CONFIG, evidence) in (SKIP, MUSIC, SPEECH)


@given(share, share, share)
def test_a_lock_that_still_fits_outweighs_every_score(p_music, p_speech, v_frac):
    assert route(p_music, p_speech, v_frac, CONFIG, CONFIG.evidence_min) == MUSIC
    without = route(p_music, p_speech, v_frac, CONFIG)
    assert route(p_music, p_speech, v_frac, CONFIG, 0.99 * CONFIG.evidence_min) == without


@given(share, share, share)
def test_where_the_papers_rule_decides_ours_agrees(p_music, p_speech, v_frac):
    label = paper_route(p_music, p_speech, v_frac, CONFIG)
    if label == MUSIC or (label == SPEECH and p_speech >= CONFIG.p_speech_min):
        assert route(p_music, p_speech, v_frac, CONFIG) == label


@pytest.mark.parametrize(
    ("p_music", "p_speech", "v_frac", "paper", "ours"),
    [
        (0.9, 0.1, 0.0, MUSIC, MUSIC),
        (0.1, 0.9, 0.8, SPEECH, SPEECH),
        (0.9, 0.2, 0.5, SKIP, MUSIC),  # a song
        (0.8, 0.8, 0.8, SKIP, MUSIC),  # somebody talks over music as loud
        (0.1, 0.8, 0.05, SKIP, SKIP),  # like speech, but nobody's voice
        (0.1, 0.95, 0.05, SKIP, SPEECH),  # somebody far away in a room
        (0.1, 0.3, 0.9, SPEECH, SKIP),  # a voice, but hardly speech
        (0.1, 0.9, math.nan, SKIP, SPEECH),  # no voice activity detector
        (math.nan, math.nan, 0.9, SKIP, SKIP),
    ],
)
def test_a_voice_has_no_veto_over_music(p_music, p_speech, v_frac, paper, ours):
    assert paper_route(p_music, p_speech, v_frac, CONFIG) == paper
    assert route(p_music, p_speech, v_frac, CONFIG) == ours


@pytest.mark.parametrize(
    "wrong",
    [
        {"v_frac_min": 0.0},
        {"p_music_min": 1.5},
        {"evidence_min": math.nan},
        {"epsilon_sp": 2.0},
        {"window_s": 0.5},
        {"silence_dbfs": 3.0},
    ],
)
def test_a_threshold_out_of_range_is_named(wrong):
    (name,) = wrong
    with pytest.raises(PerceptionError, match=f"{name}.*valid is"):
        RouterConfig(**wrong)


# The embedded model


@needs_espeak
def test_music_voices_and_noise_are_told_apart(router):
    rng = np.random.default_rng(0)
    noise = (0.05 * rng.standard_normal(6 * RATE)).astype(np.float32)
    assert heard(router, tune()).label == MUSIC
    assert heard(router, voice()).label == SPEECH
    assert heard(router, noise).label == SKIP


@pytest.mark.parametrize(
    "samples",
    [
        np.zeros(6 * RATE),
        np.full(6 * RATE, 0.3),
        1e-4 * np.random.default_rng(0).standard_normal(6 * RATE),
    ],
    ids=["silence", "offset", "hiss"],
)
def test_what_is_too_quiet_is_skipped(router, samples):
    assert heard(router, samples.astype(np.float32)).label == SKIP


def test_music_that_has_just_stopped_is_skipped(router):
    stopped = np.concatenate((tune(seconds=5.0), np.zeros(round(1.2 * RATE), np.float32)))
    assert heard(router, stopped[: 5 * RATE]).label == MUSIC
    assert heard(router, stopped).label == SKIP


@needs_espeak
def test_the_level_does_not_matter(router):
    for sound, label in ((tune(), MUSIC), (voice(), SPEECH)):
        loud = heard(router, sound)
        quiet = heard(router, sound * np.float32(0.05))
        assert loud.label == quiet.label == label
        assert quiet.p_music == pytest.approx(loud.p_music, abs=0.15)


def test_nothing_is_said_of_less_than_a_second(router):
    found = heard(router, tune()[: round(0.9 * RATE)])
    assert found.label == SKIP and math.isnan(found.p_music) and math.isnan(found.p_speech)
    assert heard(router, np.zeros(0, np.float32)).label == SKIP


@pytest.mark.parametrize("block", [1, 37, 800, 50_000])
def test_blocks_of_any_size_are_heard_as_one_piece(router, block):
    sound = tune()[: 2 * RATE] if block == 1 else tune()
    whole, pieces = heard(router, sound, len(sound)), heard(router, sound, block)
    assert pieces.label == whole.label
    assert pieces.p_music == pytest.approx(whole.p_music, abs=1e-3)
    assert pieces.v_frac == pytest.approx(whole.v_frac, abs=0.02)


def test_judging_in_between_changes_nothing(router):
    sound = tune()
    whole = heard(router, sound)
    router.reset()
    for first in range(0, len(sound), 800):
        router.hear(sound[first : first + 800], first * 1_000_000 // RATE)
        router.judge(0.0)
    found = router.judge(0.0)
    assert found.p_music == pytest.approx(whole.p_music, abs=1e-3)


@pytest.mark.parametrize("how", ["reset", "gap"])
def test_what_was_before_a_gap_is_forgotten(router, how):
    heard(router, tune())
    later = 1_000_000_000_000_000 + 60_000_000
    if how == "reset":
        router.reset()
    router.hear(tune()[: RATE // 2], later)
    assert math.isnan(router.judge(0.0).p_music)


def test_a_lock_decides_in_the_stream_too_but_not_over_silence(router):
    rng = np.random.default_rng(0)
    assert heard(router, (0.05 * rng.standard_normal(6 * RATE)).astype(np.float32)).label == SKIP
    assert router.judge(0.8).label == MUSIC
    heard(router, np.zeros(6 * RATE, np.float32))
    assert router.judge(0.8).label == SKIP


@needs_espeak
def test_without_voice_activity_the_network_decides_alone():
    router = EmbeddedRouter(vad=None)
    for sound, label in ((tune(), MUSIC), (voice(), SPEECH)):
        found = heard(router, sound)
        assert found.label == label and math.isnan(found.v_frac)


def test_samples_that_are_no_numbers_do_not_outlive_the_window(router):
    broken = tune()
    broken[1000:1100] = np.nan
    assert heard(router, broken).label in (SKIP, MUSIC, SPEECH)
    assert heard(router, tune()).label == MUSIC


def test_real_music_and_real_speech_are_told_apart(real_music, router):
    """Recordings that the weights were not made of."""
    right = []
    for folder, label in ((real_music, MUSIC), (real_music.parent / "speech", SPEECH)):
        for path in sorted(Path(folder).iterdir())[:8]:
            recording = load_recording(path)
            middle = len(recording.samples) // 2
            part = recording.samples[middle : middle + 5 * recording.sample_rate_hz]
            sound = soxr.resample(part, recording.sample_rate_hz, RATE)
            right.append(heard(router, sound, len(sound)).label == label)
    assert len(right) >= 10 and np.mean(right) >= 0.9, right


# Features and weights


def test_frames_of_pieces_are_the_frames_of_the_whole():
    sound = tune()[: 3 * RATE]
    whole, stream, found, at = FrameStream().push(sound), FrameStream(), NO_FRAMES, 0
    rng = np.random.default_rng(0)
    while at < len(sound):
        size = int(rng.integers(1, 2000))
        found = found.followed_by(stream.push(sound[at : at + size]))
        at += size
    assert len(found) == len(whole) == (len(sound) - 1024) // 256 + 1
    np.testing.assert_allclose(found.mels, whole.mels, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(found.fine, whole.fine, atol=1e-3)


@pytest.mark.parametrize("hertz", [110.0, 220.0, 400.0])
def test_the_pitch_of_a_buzz_is_its_pitch(hertz):
    t = np.arange(2 * RATE) / RATE
    buzz = sum(np.sin(2 * np.pi * hertz * k * t) / k for k in range(1, 5))
    frames = FrameStream().push((0.1 * buzz).astype(np.float32))
    assert np.median(frames.harmonicity) > 0.9
    octaves = np.median(frames.pitch) - np.log2(hertz)
    assert min(abs(octaves), abs(octaves + 1)) < 0.03  # the octave below is a period, too


def test_every_feature_is_finite_even_of_nothing():
    still = FrameStream().push(np.zeros(2 * RATE, np.float32))
    values = window_features(still, np.zeros(60, np.float32))
    assert values.shape == (NUM_FEATURES,) and np.isfinite(values).all()
    assert len(still) >= MIN_FRAMES


def test_the_weights_are_small_and_of_this_version():
    assert WEIGHTS.stat().st_size < 300_000
    assert RouterNet.load().hidden.shape[1] == NUM_FEATURES


def test_weights_that_cannot_be_used_are_named_with_the_command_that_makes_some(tmp_path):
    net = RouterNet.load()
    path = tmp_path / "old.npz"
    replace(net, mean=net.mean[:5]).save(path)
    with pytest.raises(PerceptionError, match="5 features.*train_router"):
        RouterNet.load(path)
    path.write_bytes(b"no weights")
    with pytest.raises(PerceptionError, match=r"old\.npz.*train_router"):
        RouterNet.load(path)
    with pytest.raises(PerceptionError, match=r"absent\.npz"):
        RouterNet.load(tmp_path / "absent.npz")


def test_a_router_that_does_not_exist_is_answered_with_those_that_do():
    with pytest.raises(PerceptionError, match="valid are embedded, ast"):
        make_router("clap")
    with pytest.raises(PerceptionError, match="downbeat models export ast"):
        make_router("ast")


# Training and evaluation


def test_a_network_learns_what_can_be_learnt():
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 2, (600, 2)).astype(float)
    values = 0.3 * rng.standard_normal((600, NUM_FEATURES))
    values[:, 3] += truth[:, 0]
    values[:, 9] -= 5.0 * truth[:, 1]
    values[::10, -7:] = np.nan  # no voice activity
    net = fit(values, truth, np.ones(600), 1, FitOptions(networks=2, epochs=30, batch=64))
    guess = net.scores(values) > 0.5
    assert (guess == truth).mean() > 0.95
    again = fit(values, truth, np.ones(600), 1, FitOptions(networks=2, epochs=30, batch=64))
    np.testing.assert_array_equal(net.scores(values), again.scores(values))


@pytest.mark.parametrize("ratio_db", [-10.0, 0.0, 7.0])
def test_a_mixture_has_its_ratio_while_somebody_speaks(ratio_db):
    rng = np.random.default_rng(0)
    speech = np.zeros(5 * RATE, np.float32)
    speech[RATE : 2 * RATE] = 0.1 * rng.standard_normal(RATE)
    music = 0.7 * rng.standard_normal(5 * RATE).astype(np.float32)
    added = over_music(speech, music, ratio_db) - speech
    found = 20 * np.log10(active_rms(speech) / np.sqrt(np.mean(added**2)))
    assert found == pytest.approx(ratio_db, abs=0.1)


def test_speech_and_music_of_one_level_both_count_and_the_quieter_fades():
    assert truth_over_music(0.0) == (1.0, 1.0)
    assert truth_over_music(5.0) == (0.5, 1.0) and truth_over_music(-5.0) == (1.0, 0.5)
    assert truth_over_music(20.0) == (0.0, 1.0)


def test_shares_and_intervals_of_the_evaluation_count():
    row = Row((MUSIC,), labels={"ours": [MUSIC] * 9 + [SKIP]})
    found = row.shares("ours")
    assert found["right"] == 0.9 and found["SKIP"] == 0.1
    assert found["low95"] == pytest.approx(0.555, abs=0.001)
    assert found["high95"] == pytest.approx(0.9975, abs=0.001)


@needs_espeak
def test_the_evaluation_keeps_its_contract(tmp_path, capsys):
    for name, sound in (("music", tune(2, 12.0)), ("speech", voice(12.0))):
        (tmp_path / name).mkdir()
        soundfile.write(tmp_path / name / "one.wav", sound, RATE)
    options = RouterOptions(tmp_path / "music", None, tmp_path / "speech", None, per_source=1)
    assert eval_router(options, as_json=True) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["model"] == "embedded" and 0 < found["cost_percent_of_a_core"] < 100
    assert {"music", "speech", "speech over music +0 dB", "noise and tones", "silence"} <= set(
        found["classes"]
    )
    for row in found["classes"].values():
        for rule in RULES:
            assert sum(row[rule][n] for n in ("SKIP", "MUSIC", "SPEECH")) == pytest.approx(
                1, abs=1e-3
            )
    assert found["classes"]["silence"]["ours"]["right"] == 1.0


def test_an_evaluation_of_nothing_is_refused():
    with pytest.raises(ToolError, match="--music"):
        RouterStudy(RouterOptions(None, None, None, None))
