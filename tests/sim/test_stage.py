from __future__ import annotations

import numpy as np
import pytest

from downbeat.control.observation import RobotState, observe
from downbeat.policies.manifest import load_skills
from downbeat.sim import certify
from downbeat.sim.errors import SimError
from downbeat.sim.stage import HEAVY, LATE, NOMINAL, QUIET, Act, Stage, StageSkill
from downbeat.sim.transition_report import Trial
from downbeat.sim.transition_survey import home_beats, run_trial
from downbeat.sim.verdict import Verdict, write_verdict

SKILLS = load_skills()


@pytest.fixture(scope="module")
def stand() -> StageSkill:
    return StageSkill(SKILLS["stand"])


@pytest.mark.parametrize("name", [n for n, m in SKILLS.items() if m.kind != "locomotion"])
def test_every_bundled_skill_stays_up_for_five_seconds(name: str, stand: StageSkill) -> None:
    result = certify.solo(StageSkill(SKILLS[name]), stand, NOMINAL, seed=11, seconds=5.0)
    assert not result.fell
    assert result.rmse_rad < 0.05


def test_the_walk_walks(stand: StageSkill) -> None:
    from downbeat.sim.certify_walk import drive, straight

    result = drive(StageSkill(SKILLS["walk"]), stand, NOMINAL, 0, straight)
    assert not result.fell
    assert result.x_m > 3.0
    assert abs(result.yaw_rad) < np.radians(15.0)


def test_observations_are_controls_own_terms(stand: StageSkill) -> None:
    stage = Stage(stand, QUIET)
    stage.run(10)
    qpos, qvel = stage.data.qpos, stage.data.qvel
    state = RobotState(qpos[3:7], qvel[3:6], qpos[7:], qvel[6:])
    wanted = observe(state, SKILLS["stand"].observation_names)
    np.testing.assert_allclose(stage.observe(), wanted, atol=1e-6)


def test_the_same_seed_gives_the_same_bits(stand: StageSkill) -> None:
    ends = []
    for _ in range(2):
        stage = Stage(stand, LATE, seed=3)
        stage.run(50)
        ends.append(stage.data.qpos.copy())
    np.testing.assert_array_equal(ends[0], ends[1])


def test_heavier_means_heavier(stand: StageSkill) -> None:
    masses = [Stage(stand, variation).model.body_mass.sum() for variation in (NOMINAL, HEAVY)]
    assert masses[1] == pytest.approx(1.05 * masses[0])


def test_a_limp_robot_counts_as_fallen(stand: StageSkill) -> None:
    stage = Stage(stand, QUIET)
    stage.model = stage.model.__copy__()
    stage.model.actuator_gainprm[:] = 0.0
    stage.model.actuator_biasprm[:] = 0.0
    assert not stage.run(150)
    assert stage.trace.ticks < 150


def test_the_phase_advances_by_the_rate(stand: StageSkill) -> None:
    kpop = StageSkill(SKILLS["kpop"])
    stage = Stage(stand, QUIET)
    stage.switch(Act(kpop, 1.0, 1.1), 30)
    stage.run(20)
    assert stage.act.phase_s == pytest.approx(1.0 + 1.1 * 50 * 0.02)


def test_a_held_entry_stands_at_its_phase_until_the_hold_ends(stand: StageSkill) -> None:
    zombie = StageSkill(SKILLS["zombie"])
    stage = Stage(stand, QUIET)
    stage.switch(Act(zombie, 0.0), 15, hold_ticks=7)
    assert stage.act.phase_s == pytest.approx(8 * 0.02)


def test_an_unknown_skill_to_certify_is_named() -> None:
    with pytest.raises(SimError, match="'polka' is not in .*; skills are"):
        certify.certify(["polka"])


def test_a_verdict_is_written_and_read_back(tmp_path, stand: StageSkill) -> None:
    import shutil

    from downbeat.policies.manifest import Certificate, CertificateCase, load_manifest

    folder = shutil.copytree(SKILLS["sway"].folder, tmp_path / "sway")
    case = CertificateCase("hardware noise", 30.0, 4, 0, 30.0, 0.01, 0.02)
    certificate = Certificate("m", "v", True, (1.0, 2.0, 3.0, 4.0), (case,))
    manifest = load_manifest(folder / "manifest.toml")
    written = write_verdict(manifest, Verdict(certificate, (95.0, 145.0)))
    assert written.certificate == certificate
    assert written.tempo_range_bpm == (95.0, 145.0)


def test_exits_are_looked_for_where_both_feet_are_at_home() -> None:
    assert home_beats("discostep") == [0.0, 3.0, 3.5, 4.0, 7.0, 7.5]
    assert home_beats("turnstep") == [0.0]


@pytest.mark.parametrize(
    "trial",
    [
        Trial("planted", "kpop", "thriller", 1),
        Trial("entry", "stand", "zombie", 2),
        Trial("exit", "discostep", "stand", 3),
        Trial("loop", "zombie", "turnstep", 4),
        Trial("via_stand", "boxstep", "zombie", 5),
        Trial("walk_start", "stand", "walk", 6),
        Trial("walk_stop", "walk", "stand", 7),
    ],
    ids=lambda trial: trial.kind,
)
def test_changes_that_control_makes_end_on_the_feet(trial: Trial) -> None:
    assert not run_trial(SKILLS["stand"].folder.parent, trial).fell
