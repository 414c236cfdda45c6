"""The atlas: what control reads about proven changes, and the rule of the online check."""

import json
import time

import numpy as np
import pytest
from proof_rig import SKILLS, atlas_of, cell

from downbeat.control.atlas import BUNDLED_ATLAS, UNPROVEN, Atlas, Cell, write_atlas
from downbeat.control.errors import ControlError
from downbeat.control.modes import FADE_03, FADE_06
from downbeat.control.phase import PhaseFollower, PhaseLine
from downbeat.control.planner import direct_plan
from downbeat.control.slots import entry_slots, exit_slots
from downbeat.control.transitions import Goal, beat_s
from downbeat.control.verdicts import is_refused

NOW = 1_700_000_000_000_000


def test_an_atlas_comes_back_as_it_was_written_and_never_below_its_bounds(tmp_path):
    kpop, disco = SKILLS["kpop"], SKILLS["disco"]
    shape = (exit_slots(kpop).count, entry_slots(disco).count)
    rng = np.random.default_rng(0)
    bound = rng.uniform(0.001, 0.02, shape).astype(np.float32)
    written = Cell("kpop", "disco", FADE_03.name, bound, 384, 0)
    write_atlas(tmp_path, [written], SKILLS, {"seed": 7})
    atlas = Atlas.load(tmp_path, SKILLS)
    read = atlas.cells["kpop", "disco", FADE_03.name].bound
    assert np.all(read >= bound)
    assert np.all(read <= bound * 1.002 + 1e-6)
    assert atlas.meta["seed"] == 7
    assert atlas.bound(kpop, disco, "hard", 0.0, 0.0) == UNPROVEN


def test_skills_that_have_changed_since_are_not_proven(tmp_path, caplog):
    write_atlas(tmp_path, [cell("kpop", "disco")], SKILLS, {})
    index = json.loads((tmp_path / "index.json").read_text())
    index["skills"]["kpop"] = "0" * 16
    (tmp_path / "index.json").write_text(json.dumps(index))
    assert not Atlas.load(tmp_path, SKILLS).cells
    assert "kpop" in caplog.text


@pytest.mark.parametrize("damage", ["none", "garbage", "version", "offsets"])
def test_what_is_no_atlas_is_one_sentence(tmp_path, damage):
    if damage != "none":
        write_atlas(tmp_path, [cell("kpop", "disco")], SKILLS, {})
        index = json.loads((tmp_path / "index.json").read_text())
        if damage == "garbage":
            (tmp_path / "bounds.npy").write_bytes(b"nonsense")
        elif damage == "version":
            index["version"] = 99
        else:
            index["cells"][0][3] = 10**6
        (tmp_path / "index.json").write_text(json.dumps(index))
    with pytest.raises(ControlError) as error:
        Atlas.load(tmp_path, SKILLS)
    assert str(tmp_path) in str(error.value)


def test_a_lookup_takes_far_less_than_a_millisecond():
    atlas = atlas_of(0.009, ("kpop", "disco"), ("discostep", "salsa"))
    kpop, disco = SKILLS["kpop"], SKILLS["disco"]
    atlas.bound(kpop, disco, "fade_0.3", 0.0, 0.0)
    began = time.perf_counter()
    for k in range(1000):
        atlas.bound(kpop, disco, "fade_0.3", k * 0.008 % 8.0, 0.5)
    assert (time.perf_counter() - began) / 1000 < 1e-4


def plan(atlas, source, target, onset_s, phase_s=0.0, vetoes=(), limit=0.01):
    a, b = SKILLS[source], SKILLS[target]
    onset = NOW + round(onset_s * 1e6)
    follower = PhaseFollower(PhaseLine(NOW, phase_s, 1.0), NOW, a.duration_s, beat_s(a))
    goal = Goal(b, PhaseLine(onset, 0.0, 1.0), onset)
    return direct_plan(atlas, a, follower, goal, NOW, limit, NOW, vetoes), onset


def test_footwork_is_left_only_in_proven_quarters_of_a_beat():
    one = cell("discostep", "disco")
    bound = one.bound.copy()
    bound[:] = 1.0
    bound[8] = 0.009  # the third beat, at 1.0 s of skill time
    atlas = Atlas([Cell("discostep", "disco", one.mode, bound, 384, 0)])
    found, onset = plan(atlas, "discostep", "disco", 1.0)
    assert found is not None
    assert found.onset_utime == onset
    assert plan(atlas, "discostep", "disco", 1.06)[0].onset_utime < NOW + 1_060_000
    assert plan(atlas, "discostep", "disco", 1.2)[0] is None


def test_an_unproven_entry_is_entered_whole_beats_elsewhere():
    one = cell("kpop", "disco")
    bound = one.bound.copy()
    bound[:, 0] = 1.0
    atlas = Atlas([Cell("kpop", "disco", one.mode, bound, 384, 0)])
    found, onset = plan(atlas, "kpop", "disco", 2.0)
    assert found.onset_utime == onset
    assert found.hop.shift_s == pytest.approx(4 * 0.5)  # a bar of the skill's own 120 BPM


def test_a_refused_plan_gives_way_to_the_next_mode():
    atlas = Atlas([cell("kpop", "disco"), cell("kpop", "disco", mode=FADE_06.name)])
    first, _ = plan(atlas, "kpop", "disco", 2.0)
    veto = (first.hop.to_skill, first.mode, first.exit_slot)
    second, _ = plan(atlas, "kpop", "disco", 2.0, vetoes=(veto,))
    assert first.mode == FADE_03.name
    assert (second.hop.to_skill, second.mode, second.exit_slot) != veto


@pytest.mark.parametrize("bound", [0.003, 0.01])
def test_checks_of_a_plan_at_its_bound_refuse_it_at_most_once_in_two_hundred(bound):
    rng = np.random.default_rng(1)
    for count in (8, 16, 32):
        fallen = rng.binomial(count, bound, 40_000)
        refused = np.mean([is_refused(bound, int(k), count) for k in fallen])
        assert refused <= 0.006


def test_checks_refuse_what_falls_one_time_in_four():
    rng = np.random.default_rng(2)
    fallen = rng.binomial(32, 0.25, 10_000)
    assert np.mean([is_refused(0.01, int(k), 32) for k in fallen]) > 0.98


@pytest.mark.skipif(not BUNDLED_ATLAS.exists(), reason="no bundled atlas yet")
def test_every_bundled_skill_has_a_proven_way_to_stand_at_least_once_a_loop():
    atlas = Atlas.load(BUNDLED_ATLAS, SKILLS)
    for name in SKILLS:
        cells = [c for key, c in atlas.cells.items() if key[:2] == (name, "stand")]
        assert name == "stand" or min(float(c.bound.min()) for c in cells) <= 0.0101, name
