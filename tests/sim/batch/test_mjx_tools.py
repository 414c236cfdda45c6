"""Sweep and checker run on MJX from end to end and leave what the native engine leaves."""

import json

import numpy as np
import pytest

pytest.importorskip("jax", reason="the extra mjx is not installed")
pytest.importorskip("mujoco.mjx", reason="the extra mjx is not installed")

from downbeat.control.atlas import Atlas
from downbeat.control.prover import ProofConfig
from downbeat.policies.manifest import load_skills
from downbeat.sim.batch.bench_check import capture_query
from downbeat.sim.batch.pair import Depth
from downbeat.sim.checker import Checker
from downbeat.tools.sweep import SweepOptions, sweep

SKILLS = ("stand", "sway")
TINY = Depth(target=0.5, max_blocks=2, robots=8)

pytestmark = pytest.mark.slow


def test_a_sweep_on_mjx_writes_the_atlas_that_the_native_one_writes(tmp_path, capsys):
    index = {}
    for engine in ("native", "mjx"):
        out = tmp_path / engine
        options = SweepOptions(
            out=out, skills=SKILLS, engine=engine, workers=1, depth=TINY, json=True
        )
        sweep(options)
        index[engine] = json.loads((out / "atlas" / "index.json").read_text())
        atlas = Atlas.load(out / "atlas", load_skills())
        assert atlas.pairs == {("stand", "sway"), ("sway", "stand")}
        assert np.load(out / "atlas" / "bounds.npy").dtype == np.float16
    assert index["native"].keys() == index["mjx"].keys()
    assert index["native"]["skills"] == index["mjx"]["skills"]
    # Nobody falls between stand and sway, on any engine: the same cells, bounds and counts.
    assert index["native"]["cells"] == index["mjx"]["cells"]


def test_a_check_on_mjx_finds_a_proven_change_safe():
    query, atlas = capture_query()
    query.num_rollouts, query.horizon_s = 4, 0.3
    query.control_state_hash, query.profile = 0, "stage"
    checker = Checker(load_skills(), atlas, ProofConfig(use_checker=True), threads=1, engine="mjx")
    outcome = checker.check(query).outcome
    assert outcome is not None and outcome.count == 4
    assert not outcome.fell.any()
