"""The MJX engine: the same closed loop as the native one, on what JAX finds."""

import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("jax", reason="the extra mjx is not installed")
pytest.importorskip("mujoco.mjx", reason="the extra mjx is not installed")

from downbeat.policies.manifest import load_skills
from downbeat.sim.batch import engine as engines
from downbeat.sim.batch.engine import open_engine
from downbeat.sim.batch.perturb import draw_block, load_profile
from downbeat.sim.batch.script import Switch, rate_for, script_of
from downbeat.sim.batch.states import standing_start
from downbeat.sim.errors import SimError

SKILLS = load_skills()
COUNT = 8
TICKS = 24


@pytest.fixture(scope="module")
def mjx():
    return open_engine("mjx", SKILLS)


def loop(push_n_s=0.0):
    draws = draw_block(load_profile(), 1, 0).take(np.arange(COUNT))
    draws.push_n_s[:] = 0.0
    draws.push_n_s[: COUNT // 2, 0] = push_n_s
    draws.push_s[:] = 0.1
    skill = SKILLS["discostep"]
    rate = rate_for(skill, draws.tempo_bpm[:, 1])
    switch = Switch(skill, 4, 6, "full", np.zeros(1), rate, True)
    script = script_of(SKILLS["stand"], np.zeros(1), np.ones(1), (switch,), TICKS)
    return standing_start(COUNT), script, draws


@pytest.mark.slow
def test_both_engines_measure_the_same_calm_change(mjx):
    start, script, draws = loop()
    theirs = open_engine("native", SKILLS, 1).run(start, script, draws, (0,))
    ours = mjx.run(start, script, draws, (0,))
    assert not ours.fell.any() and not theirs.fell.any()
    assert np.abs(ours.end_error - theirs.end_error).max() < 0.02
    assert np.abs(ours.max_tilt - theirs.max_tilt).max() < 0.03
    assert np.abs(ours.min_margin - theirs.min_margin).max() < 0.03
    assert np.abs(ours.max_torque_ratio - theirs.max_torque_ratio).max() < 0.2


@pytest.mark.slow
def test_both_engines_see_the_pushed_half_fall(mjx):
    start, script, draws = loop(push_n_s=60.0)
    for engine in (open_engine("native", SKILLS, 1), mjx):
        fell = engine.run(start, script, draws, (0,)).fell
        assert fell[: COUNT // 2].all() and not fell[COUNT // 2 :].any()


@pytest.mark.slow
def test_equal_runs_are_equal_and_the_batch_size_does_not_matter(mjx):
    start, script, draws = loop()
    first, again = (mjx.run(start, script, draws, (3,)) for _ in range(2))
    assert np.array_equal(first.end_error, again.end_error)


def test_other_minor_versions_are_refused(monkeypatch):
    versions = {"mujoco": "4.0.0", "mujoco-mjx": "3.17.0"}
    monkeypatch.setattr(engines, "version", versions.__getitem__)
    with pytest.raises(SimError, match=r"mujoco 4\.0\.0 and mujoco-mjx 3\.17\.0"):
        open_engine("mjx", SKILLS)


def test_warp_says_what_it_needs_where_it_is_not():
    try:
        import warp  # noqa: F401
    except ImportError:
        with pytest.raises(SimError, match="warp"):
            open_engine("warp", SKILLS)
    else:
        pytest.skip("warp is installed")


BARE = """
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"onnxruntime", "lcm", "soundfile", "librosa", "rich"}:
            raise ImportError(f"{name} is not on this machine")
sys.meta_path.insert(0, Block())
from downbeat.sim.batch.mjx import MjxEngine
from downbeat.sim.batch.states import standing_start
from downbeat.policies.manifest import load_skills
engine = MjxEngine(load_skills())
engine.skill("stand"), engine.skill("walk")
print("ready", standing_start(2).count)
"""


def test_the_engine_needs_only_mujoco_mjx_jax_numpy_and_onnx():
    run = subprocess.run([sys.executable, "-c", BARE], capture_output=True, text=True, timeout=200)
    assert "ready 2" in run.stdout, run.stderr[-2000:]


@pytest.mark.slow
def test_a_batch_is_split_over_devices(tmp_path):
    code = """
import sys, jax
sys.path.insert(0, sys.argv[1])
assert len(jax.devices()) == 2
import test_mjx as t
engine = t.open_engine("mjx", t.SKILLS)
outcome = engine.run(*t.loop(), (0,))
assert outcome.count == t.COUNT and not outcome.fell.any()
print("split over", len(engine.devices))
"""
    env = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    import os
    from pathlib import Path

    run = subprocess.run(
        [sys.executable, "-c", code, str(Path(__file__).parent)],
        capture_output=True,
        text=True,
        env={**os.environ, **env},
        timeout=280,
    )
    assert "split over 2" in run.stdout, run.stderr[-2000:]
