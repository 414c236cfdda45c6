"""Robots are drawn block by block: robot i of a seed is the same in every batch and shard."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.sim.batch.perturb import (
    BLOCK,
    PROFILES,
    SUBSTEP_S,
    Draws,
    draw_block,
    join_draws,
    load_profile,
    profile_names,
)
from downbeat.sim.errors import SimError

BLOCKS = st.integers(0, 40)


def same(a, b):
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name)) for f in fields(Draws))


@given(seed=st.integers(0, 2**31), block=BLOCKS)
def test_a_block_is_the_same_whoever_draws_it_and_whatever_was_drawn_before(seed, block):
    profile = load_profile()
    first = draw_block(profile, seed, block)
    draw_block.cache_clear()
    draw_block(profile, seed, block + 1)
    assert same(first, draw_block(profile, seed, block))


@given(block=BLOCKS, rows=st.lists(st.integers(0, BLOCK - 1), min_size=1, max_size=8))
def test_a_robot_is_the_same_alone_and_among_others(block, rows):
    whole = draw_block(load_profile(), 0, block)
    alone = [whole.take([row]) for row in rows]
    assert same(join_draws(alone), whole.take(rows))


def test_blocks_and_seeds_hold_different_robots():
    profile = load_profile()
    masses = [draw_block(profile, seed, block).mass_scale for seed in (0, 1) for block in range(4)]
    assert len(np.unique(np.concatenate(masses))) == 8 * BLOCK


@given(block=BLOCKS)
def test_every_robot_lies_inside_its_profile(block):
    profile = load_profile()
    draws = draw_block(profile, 3, block)
    for value, (low, high) in (
        (draws.mass_scale, profile.mass_scale),
        (draws.com_offset_m, profile.com_offset_m),
        (draws.friction, profile.friction),
        (draws.stiffness_scale, profile.gain_scale),
        (draws.damping_scale, profile.gain_scale),
        (draws.tempo_bpm, profile.tempo_bpm),
        (np.hypot(*draws.push_n_s.T), profile.impulse_n_s),
        (draws.delay_substeps * SUBSTEP_S, profile.command_s),
    ):
        assert (value >= low - 1e-9).all() and (value <= high + 1e-9).all()
    assert draws.count == BLOCK


def test_about_half_of_the_robots_keep_the_tempo():
    tempo = np.concatenate([draw_block(load_profile(), 0, b).tempo_bpm for b in range(20)])
    kept = np.mean(tempo[:, 0] == tempo[:, 1])
    assert kept == pytest.approx(load_profile().same_tempo, abs=0.06)


def test_another_profile_draws_the_same_nights_in_other_ranges():
    stage = load_profile()
    heavy = replace(stage, mass_scale=(1.0, 1.1))
    a, b = draw_block(stage, 0, 5), draw_block(heavy, 0, 5)
    assert np.array_equal(a.friction, b.friction)
    assert not np.array_equal(a.mass_scale, b.mass_scale)


def test_every_bundled_profile_loads():
    for name in profile_names():
        assert load_profile(name).name


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mass_scale = [0.95, 1.05]", "mass_scale = [1.05, 0.95]", "robot.mass_scale"),
        ("mass_scale = [0.95, 1.05]", "mass_scale = 1.0", "[low, high] is valid"),
        ("[floor]", "[ground]", "floor.friction is missing"),
        ("same_tempo = 0.5", 'same_tempo = "half"', "a number from 0 to 1000"),
        ("[robot]", "[robot", "is not TOML"),
    ],
)
def test_a_wrong_profile_is_one_sentence(tmp_path, old, new, said):
    text = (PROFILES / "stage.toml").read_text()
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new))
    with pytest.raises(SimError) as error:
        load_profile(str(path))
    assert said in str(error.value) and "mine.toml" in str(error.value)


def test_an_unknown_profile_names_the_bundled_ones():
    with pytest.raises(SimError, match="stage"):
        load_profile("arena")
