"""The course of a proof follows from its rows; hopeless slots are dropped, the rest proven anew."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.control.modes import FADE_03, FADE_06
from downbeat.sim.batch.pair import CONFIDENCE, ROW, Depth, Pair
from downbeat.sim.batch.proof import upper_bound

DEPTH = Depth()


def simulate(task, share, seed=0):
    """Rows of a task when each robot falls with the chance of its slots."""
    rng = np.random.default_rng([seed, task.block, task.mode])
    count = DEPTH.robots
    rows = np.zeros(count, ROW)
    rows["mode"], rows["stage"], rows["block"] = task.mode, task.stage, task.block
    rows["robot"] = np.arange(count)
    rows["exit_slot"] = rng.permutation(np.resize(task.exits, count))
    rows["entry_slot"] = rng.permutation(np.resize(task.entries, count))
    chance = share[task.mode][rows["exit_slot"], rows["entry_slot"]]
    rows["fell"] = rng.uniform(size=count) < chance
    return rows


def prove(share, modes=(FADE_03,), parts=1, seed=0, depth=DEPTH):
    """A pair taken to its end; share: (modes, exits, entries) chance of a fall."""
    pair = Pair(modes, share.shape[1], share.shape[2], parts)
    tasks = []
    while (task := pair.next_task(depth)) is not None:
        pair.add(simulate(task, share, seed))
        tasks.append(task)
        assert len(tasks) < 200
    return pair, tasks


def test_a_clean_pair_is_proven_at_every_slot_with_the_first_mode_alone():
    pair, tasks = prove(np.zeros((2, 8, 4)), (FADE_03, FADE_06))
    (finding,) = pair.findings()
    assert finding.mode is FADE_03
    assert finding.exits == tuple(range(8)) and finding.entries == tuple(range(4))
    assert finding.bound <= DEPTH.target
    assert [task.block for task in tasks] == list(range(6))


def test_a_hopeless_slot_is_dropped_and_the_rest_proven_on_fresh_rows():
    share = np.zeros((1, 8, 1))
    share[0, 3] = 1.0
    pair, tasks = prove(share)
    (finding,) = pair.findings()
    assert finding.exits == (0, 1, 2, 4, 5, 6, 7)
    assert finding.bound <= DEPTH.target
    # Nothing that the slots were chosen by is counted.
    fresh = pair.all_rows()[pair.all_rows()["stage"] == 2]
    assert finding.count == len(fresh) and finding.fallen == 0
    assert 3 not in fresh["exit_slot"]
    first = {task.block for task in tasks if task.stage == 1}
    assert first.isdisjoint(task.block for task in tasks if task.stage == 2)


def test_when_every_exit_fails_a_hopeless_entry_is_dropped():
    share = np.zeros((1, 4, 8))
    share[0, :, 5] = 1.0
    pair, _ = prove(share)
    (finding,) = pair.findings()
    assert finding.exits == (0, 1, 2, 3)
    assert 5 not in finding.entries and finding.bound <= DEPTH.target


def test_a_hopeless_pair_costs_one_block_per_mode():
    pair, tasks = prove(np.ones((2, 8, 4)), (FADE_03, FADE_06))
    assert [(task.mode, task.stage) for task in tasks] == [(0, 1), (1, 1)]
    assert all(finding.bound > DEPTH.target for finding in pair.findings())


def test_the_next_mode_is_tried_where_the_first_one_falls():
    share = np.zeros((2, 8, 1))
    share[0] = 0.5
    pair, _ = prove(share, (FADE_03, FADE_06))
    bad, good = pair.findings()
    assert bad.bound > DEPTH.target >= good.bound
    assert good.exits == tuple(range(8))


def test_footwork_drops_the_whole_beat_at_which_somebody_fell():
    share = np.zeros((2, 16, 1))
    share[0, 5] = 1.0
    pair, tasks = prove(share, (FADE_06, FADE_03), parts=4)
    assert {task.mode for task in tasks} == {0}  # three beats of four are enough
    assert pair.findings()[0].exits == (0, 1, 2, 3, *range(8, 16))


def test_footwork_that_can_be_left_at_few_beats_needs_the_second_mode():
    share = np.zeros((2, 16, 1))
    share[0, [1, 5]] = 1.0
    _, tasks = prove(share, (FADE_06, FADE_03), parts=4)
    assert {task.mode for task in tasks} == {0, 1}


def test_a_proof_that_cannot_be_reached_any_more_is_given_up():
    pair, tasks = prove(np.full((1, 16, 1), 0.009), parts=4)
    for stage, confidence in enumerate(CONFIDENCE, 1):
        mine = pair.all_rows()[pair.all_rows()["stage"] == stage]
        before = mine[mine["block"] < mine["block"].max()] if len(mine) else mine
        fallen, most = int(before["fell"].sum()), DEPTH.max_blocks * DEPTH.robots
        assert upper_bound(fallen, most, confidence) <= DEPTH.target


def test_a_proof_that_is_reached_with_the_last_block_is_not_begun_again():
    depth = Depth(target=0.06, max_blocks=1)
    _, tasks = prove(np.zeros((1, 4, 1)), depth=depth)
    assert len(tasks) == 1


@given(seed=st.integers(0, 10_000), cut=st.floats(0.0, 1.0))
def test_wherever_a_proof_is_cut_it_goes_on_the_same_way(seed, cut):
    share = np.zeros((2, 6, 2))
    share[0] = 0.02
    share[0, 2] = 0.4
    whole, tasks = prove(share, (FADE_03, FADE_06), seed=seed)
    kept = round(cut * len(tasks))
    again = Pair((FADE_03, FADE_06), 6, 2)
    if kept:
        again.add(np.concatenate(whole.rows[:kept]))
    for task in tasks[kept:]:
        assert again.next_task(DEPTH) == task
        again.add(simulate(task, share, seed))
    assert again.next_task(DEPTH) is None
    assert again.all_rows().tobytes() == whole.all_rows().tobytes()


@pytest.mark.parametrize("share", [0.004, 0.012, 0.03])
def test_whatever_is_dropped_on_the_way_the_bound_is_broken_in_one_of_twenty_proofs(share):
    """Slots of very different chances, chosen by what fell: the bound is of what is left."""
    broken = proofs = 0
    for seed in range(400):
        rng = np.random.default_rng([seed, 7])
        chance = rng.exponential(share, (1, 12, 1)).clip(0.0, 1.0)
        pair, _ = prove(chance, seed=seed)
        (finding,) = pair.findings()
        if finding.count:
            proofs += 1
            broken += finding.bound < chance[0][list(finding.exits)].mean()
    assert proofs > 100
    assert broken <= 0.05 * 400
