"""What the follower's weights are learned with."""

import json
from importlib import resources

import numpy as np
import pytest

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.perception.rhythm import FEATURES, NUM_PHASES, TEMPOS_BPM, bundled_template
from downbeat.tools.follow_reference import Reference
from downbeat.tools.train_follow import learn, right_choices
from downbeat.tools.train_surety import is_right, looks, regress

RATE = 16_000


def test_learning_finds_which_features_tell_the_right_choice():
    rng = np.random.default_rng(0)
    values = rng.standard_normal((900, 12, FEATURES)).astype(np.float16)
    score = values[..., 5].astype(np.float64) - 0.5 * np.abs(values[..., 9])
    right = score >= score.max(axis=1, keepdims=True)
    template = learn(values[:800], right[:800], np.ones(800, np.float32), rng)
    x = values[800:].astype(np.float64)
    hidden = np.tanh(x @ template.weights[1:].T + template.bias)
    found = (x @ template.weights[0] + hidden @ template.out).argmax(axis=1)
    assert np.mean(right[800:][np.arange(100), found]) > 0.6  # by chance 0.08


def test_right_choices_name_the_beat_and_its_octaves():
    right = right_choices(Reference(BeatGrid(80.0, 0.1), np.zeros(0), 60.0), 10.0)
    near = right.any(axis=1)
    assert near[np.abs(np.log(TEMPOS_BPM / 80.0)) < 0.01].all()
    assert near[np.abs(np.log(TEMPOS_BPM / 160.0)) < 0.01].all()
    assert not near[np.abs(np.log(TEMPOS_BPM / 120.0)) < 0.05].any()
    assert 0 < right.sum() < 0.05 * right.size
    assert right.shape[1] == NUM_PHASES


def test_the_regression_finds_the_odds():
    rng = np.random.default_rng(1)
    evidence = rng.standard_normal((20_000, 3)) * [1.0, 5.0, 0.2] + 2.0
    odds = evidence @ [1.5, -0.3, 0.0] + 0.4
    right = rng.random(20_000) < 1.0 / (1.0 + np.exp(-odds))
    weights, bias = regress(evidence, right, np.ones(20_000))
    assert weights == pytest.approx([1.5, -0.3, 0.0], abs=0.15)
    assert bias == pytest.approx(0.4, abs=0.35)


def test_a_beat_is_right_at_an_octave_and_wrong_between_beats():
    reference = Reference(BeatGrid(120.0, 0.2), np.zeros(0), 60.0)
    assert is_right(10.2, 0.5, reference)
    assert is_right(10.7, 1.0, reference)
    assert not is_right(10.45, 0.5, reference)
    assert not is_right(10.2, 0.66, reference)


def test_each_look_is_taken_once():
    t = np.arange(12 * RATE) / RATE
    sound = (np.exp(-((t * 2.0) % 1.0) * 20.0) * np.sin(2 * np.pi * 70.0 * t)).astype(np.float32)
    reference = Reference(BeatGrid(120.0, 0.0), np.zeros(0), 12.0)
    seen = list(looks(sound, bundled_template(), reference))
    assert 35 <= len(seen) <= 41
    assert sum(right for _, right in seen[-10:]) >= 8
    assert not any(right for _, right in looks(sound, bundled_template(), None))


def test_the_weights_in_the_wheel_are_small_and_finite():
    for name in ("beat_template.json", "beat_surety.json"):
        file = resources.files("downbeat.perception") / "data" / name
        text = file.read_text(encoding="utf-8")
        assert len(text) < 16_000
        for part in json.loads(text).values():
            assert np.isfinite(part).all()
