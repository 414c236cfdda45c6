"""Every public format becomes a skill that control plays; what is wrong is named in a sentence."""

import os
from pathlib import Path

import foreign_policies as made
import numpy as np
import pytest

from downbeat.control.errors import ControlError
from downbeat.control.golden import states, verify_golden
from downbeat.control.network import NetworkSkill
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.safe_yaml import read_yaml
from downbeat.policies.manifest import load_manifest, load_skills
from downbeat.policies.spec_toml import spec_from_table, spec_to_table
from downbeat.policies.toml_text import to_toml
from downbeat.runtime.errors import DownbeatError
from downbeat.tools.cli import main
from downbeat.tools.policy_import import import_policy

SHARED = Path(__file__).resolve().parents[3] / "shared" / "policies"
SAMPLES = (
    "beyondmimic/waltz.onnx",
    "holosoma/ppo_g1_29dof.onnx",
    "unitree_rl_gym/lstm12.onnx",
    "unitree_rl_lab/dance_102",
    "unitree_rl_lab/gangnam_style",
    "unitree_rl_lab/my_dance",
    "unitree_rl_lab/velocity",
    "unitree_rl_mjlab/velocity",
)
ZERO = np.zeros(3, np.float32)


def play(manifest, ticks=10, command=ZERO):
    skill = NetworkSkill(manifest)
    memory = skill.begin(states()[0], 0.0)
    return [
        skill.step(memory, state, k * 0.02, command) for k, state in enumerate(states(1, ticks))
    ]


@pytest.mark.parametrize("sample", SAMPLES)
def test_sample_imports_with_no_further_option(sample, tmp_path):
    if not SHARED.is_dir():
        pytest.skip("no ../shared/policies beside this checkout")
    assert main(["policy", "import", str(SHARED / sample), "--out", str(tmp_path), "--json"]) == 0
    (manifest,) = load_skills(tmp_path).values()
    outputs = play(manifest)
    assert all(np.isfinite(output.targets.joint_pos).all() for output in outputs)
    assert verify_golden(NetworkSkill(manifest)) == 0.0


def test_all_samples_fit_into_one_folder(tmp_path):
    if not SHARED.is_dir():
        pytest.skip("no ../shared/policies beside this checkout")
    for sample in SAMPLES:
        import_policy(SHARED / sample, tmp_path)
    skills = load_skills(tmp_path)
    assert len(skills) == len(SAMPLES)
    assert {"unitree_rl_lab_velocity", "unitree_rl_mjlab_velocity"} <= set(skills)
    for name, seconds in (("dance_102", 21.2), ("gangnam_style", 20.3), ("my_dance", 10.0)):
        assert skills[name].duration_s == pytest.approx(seconds, abs=0.05)


def test_beyondmimic_motion_is_cut_out_of_the_graph(tmp_path):
    path = made.beyondmimic(tmp_path / "dance.onnx")
    manifest = import_policy(path, tmp_path / "out")
    assert manifest.kind == "tracking"
    assert manifest.policy.motion.rows == made.MOTION_ROWS
    assert manifest.duration_s == pytest.approx(made.MOTION_ROWS / 50)
    first = play(manifest)[0].obs
    assert first[:29] == pytest.approx(made.by_name(made.ROBOT.default_joint_pos), abs=1e-3)


def test_robot_that_follows_the_motion_sees_no_anchor_error(tmp_path):
    """Aligned at entry: wherever the robot heads, the reference heads there, too."""
    manifest = import_policy(made.beyondmimic(tmp_path / "dance.onnx"), tmp_path / "out")
    skill = NetworkSkill(manifest)
    base = states()[0]
    for heading in (0.0, 1.0, -2.5):
        quat = np.array([np.cos(heading / 2), 0, 0, np.sin(heading / 2)], np.float32)
        pos = np.zeros(29, np.float32)
        state = type(base)(quat, ZERO, pos, pos, ZERO, np.array([3.0, -1.0, 0.7], np.float32))
        memory = skill.begin(state, 0.0)
        obs = skill.step(memory, state, 0.0, ZERO).obs
        assert obs[58:64] == pytest.approx([1, 0, 0, 1, 0, 0], abs=1e-5)


def test_mjlab_velocity_takes_a_command(tmp_path):
    manifest = import_policy(made.mjlab_velocity(tmp_path / "walker.onnx"), tmp_path / "out")
    assert manifest.kind == "locomotion"
    assert any("command.vx" in line for line in manifest.inferred)
    command = np.array([0.3, 0.1, -0.2], np.float32)
    assert play(manifest, command=command)[0].obs[-3:] == pytest.approx(command)


def test_holosoma_terms_are_alphabetical_and_its_gaps_are_said(tmp_path):
    manifest = import_policy(made.holosoma(tmp_path / "ppo.onnx"), tmp_path / "out")
    names = manifest.observation_names
    assert names[:2] == ("last_action", "base_ang_vel")
    assert names[-1] == "feet_phase_sin"
    assert any(line.startswith("action_scale = 0.25") for line in manifest.inferred)
    still, moving = (
        play(manifest)[5].obs,
        play(manifest, command=np.full(3, 0.3, np.float32))[5].obs,
    )
    assert still[32:37] == pytest.approx([0, 0, 0, -1, -1]), "yaw, vx, vy, then cos of both feet"
    assert moving[35] != pytest.approx(-1.0)


def test_unitree_gains_are_in_motor_order_and_defaults_in_policy_order(tmp_path):
    folder = made.unitree_velocity(tmp_path / "velocity")
    spec = import_policy(folder, tmp_path / "out").policy
    assert spec.joint_names == made.ISAAC
    assert spec.joint_stiffness == pytest.approx(made.by_name(made.ROBOT.joint_stiffness))
    assert spec.default_joint_pos == pytest.approx(made.by_name(made.ROBOT.default_joint_pos))


def test_unitree_history_is_oldest_first_and_starts_with_the_first_sample(tmp_path):
    manifest = import_policy(made.unitree_velocity(tmp_path / "velocity"), tmp_path / "out")
    outputs = play(manifest, 7)
    rates = [state.base_ang_vel * np.float32(0.2) for state in states(1, 7)]
    first = outputs[0].obs[:15].reshape(5, 3)
    assert first == pytest.approx(np.tile(rates[0], (5, 1)))
    later = outputs[6].obs[:15].reshape(5, 3)
    assert later == pytest.approx(np.stack(rates[2:7]))


def test_rl_gym_holds_the_other_joints_and_keeps_its_recurrent_state(tmp_path):
    manifest = import_policy(made.rl_gym(tmp_path / "lstm.onnx"), tmp_path / "out")
    spec = manifest.policy
    assert spec.num_joints == 12
    assert len(spec.held.joint_names) == 17
    skill = NetworkSkill(manifest)
    memory = skill.begin(states()[0], 0.0)
    before = memory.recurrent["h_in"].copy()
    output = skill.step(memory, states()[0], 0.0, ZERO)
    assert (memory.recurrent["h_in"] != before).any()
    assert (output.targets.joint_pos[12:] == 0.0).all()
    assert (skill.begin(states()[0], 0.0).recurrent["h_in"] == 0.0).all()


def test_g1_yaml_beside_the_network_is_used(tmp_path):
    path = made.rl_gym(tmp_path / "lstm.onnx")
    (tmp_path / "g1.yaml").write_text(
        "kps: [1, 2, 3, 4, 5, 6, 1, 2, 3, 4, 5, 6]\nkds: [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
        "default_angles: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]\nang_vel_scale: 0.25\n"
        "dof_pos_scale: 1.0\ndof_vel_scale: 0.05\naction_scale: 0.5\ncmd_scale: [2.0, 2.0, 0.25]\n"
    )
    spec = import_policy(path, tmp_path / "out").policy
    assert spec.joint_stiffness[:6] == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert spec.action_scale[0] == 0.5


def test_manifest_survives_the_round_trip(tmp_path):
    import tomllib

    for path in (made.beyondmimic(tmp_path / "a.onnx"), made.rl_gym(tmp_path / "b.onnx")):
        spec = import_policy(path, tmp_path / "out").policy
        table = tomllib.loads(to_toml({"policy": spec_to_table(spec)}))["policy"]
        assert spec_from_table(table, "x.toml:policy") == spec


def test_set_replaces_what_the_files_say(tmp_path):
    path = made.beyondmimic(tmp_path / "a.onnx", action_scale=None)
    with pytest.raises(PolicyError, match="does not say action_scale.*--set action_scale=VALUE"):
        import_policy(path, tmp_path / "out")
    spec = import_policy(path, tmp_path / "out", settings=("action_scale=0.25",)).policy
    assert set(spec.action_scale) == {0.25}
    with pytest.raises(PolicyError, match="'speed' cannot be set"):
        import_policy(path, tmp_path / "out", settings=("action_scale=0.25", "speed=3"))


def long_names(n):
    return ",".join(made.ISAAC[:n])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        (
            {"joint_names": made.csv(("left_tail_joint", *made.ISAAC[1:]))},
            "'left_tail_joint' is unk",
        ),
        ({"joint_names": long_names(28)}, "29 values for 28 joints"),
        ({"joint_names": made.csv((*made.ISAAC[:28], made.ISAAC[0]))}, "listed twice"),
        ({"joint_stiffness": made.csv([40.0] * 28 + ["nan"])}, "not a finite number"),
        ({"joint_stiffness": made.csv([40.0] * 28 + [-5.0])}, "outside 0..1000"),
        ({"joint_damping": "a,b"}, "'a' is not a number"),
        ({"observation_names": "command,telepathy"}, "'telepathy' is unknown"),
        ({"observation_names": "command,base_ang_vel"}, "takes 154 numbers, but its terms are 61"),
        ({"anchor_body_name": "head"}, "'head' cannot be tracked; valid are torso_link and pelvis"),
    ],
)
def test_contradicting_metadata_is_named(tmp_path, changes, reason):
    path = made.beyondmimic(tmp_path / "a.onnx", **changes)
    with pytest.raises(PolicyError, match=reason) as caught:
        import_policy(path, tmp_path / "out")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"ids": [0, 0, 1]}, "must hold different motor numbers"),
        ({"ids": [99]}, "must hold different motor numbers"),
        ({"kp": [1.0, 2.0]}, "motor order"),
        ({"default": [0.0] * 5}, "5 values for 29 joints"),
        ({"terms": "  joint_pos_rel: {scale: [1.0, 2.0], history_length: 1}\n"}, "2 scales for 29"),
        ({"terms": "  base_ang_vel: {history_length: -3}\n"}, "history of -3"),
        ({"terms": "  sixth_sense: {history_length: 1}\n"}, "'sixth_sense' is unknown"),
        ({"terms": "  base_ang_vel: {scale: [.nan, 1, 1]}\n"}, "not a finite number"),
        ({"terms": "  base_ang_vel: [1, 2\n"}, "not valid YAML"),
    ],
)
def test_contradicting_yaml_is_named(tmp_path, changes, reason):
    folder = made.unitree_velocity(tmp_path / "velocity", **changes)
    with pytest.raises(PolicyError, match=reason) as caught:
        import_policy(folder, tmp_path / "out")
    assert "\n" not in str(caught.value)


def test_yaml_tags_are_never_constructed(tmp_path):
    flag = tmp_path / "owned"
    path = tmp_path / "evil.yaml"
    path.write_text(
        f'a: !!python/object/apply:os.system ["touch {flag}"]\nb: !!python/name:os.rmdir x\n'
    )
    table = read_yaml(path)
    assert not flag.exists()
    assert table["a"] == [f"touch {flag}"]


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [x, x, x, x, x, x, x, x, x, x]\n"
        + "".join(f"{b}: &{b} [{','.join([f'*{a}'] * 10)}]\n" for a, b in zip("abcdef", "bcdefg")),
        "a: &a [*a]\n",
        "a: " + "[" * 200 + "]" * 200 + "\n",
        "- 1\n- 2\n",
        "a: \x00",
        "a: b: c: d",
    ],
)
def test_hostile_yaml_is_refused(tmp_path, text):
    path = tmp_path / "deploy.yaml"
    path.write_text(text)
    with pytest.raises(PolicyError, match=r"deploy\.yaml is not"):
        read_yaml(path)


def test_harmless_yaml_aliases_are_read(tmp_path):
    path = tmp_path / "deploy.yaml"
    path.write_text("a: &x [1, 2]\nb: *x\n")
    assert read_yaml(path) == {"a": [1, 2], "b": [1, 2]}


def test_huge_yaml_is_refused(tmp_path):
    path = tmp_path / "deploy.yaml"
    path.write_text("a: 1\n" * 300_000)
    with pytest.raises(PolicyError, match="larger than"):
        read_yaml(path)


@pytest.mark.parametrize("content", [b"", b"not onnx at all", b"\x08\x07" * 50, os.urandom(4000)])
def test_corrupt_network_is_refused(tmp_path, content):
    path = tmp_path / "broken.onnx"
    path.write_bytes(content)
    with pytest.raises(PolicyError, match="not an ONNX model"):
        import_policy(path, tmp_path / "out")
    assert main(["policy", "import", str(path), "--out", str(tmp_path / "out")]) == 2


def test_cut_off_network_is_refused(tmp_path):
    path = made.beyondmimic(tmp_path / "dance.onnx")
    path.write_bytes(path.read_bytes()[:-3000])
    with pytest.raises(DownbeatError):
        import_policy(path, tmp_path / "out")


def test_weights_outside_the_folder_are_refused(tmp_path):
    import onnx

    path = made.mjlab_velocity(tmp_path / "inside" / "walker.onnx")
    model = onnx.load(str(path))
    onnx.save(
        model, str(path), save_as_external_data=True, location="walker.data", size_threshold=0
    )
    import_policy(path, tmp_path / "out")
    model = onnx.load(str(path), load_external_data=False)
    for tensor in model.graph.initializer:
        for entry in tensor.external_data:
            if entry.key == "location":
                entry.value = "../secret.data"
    path.write_bytes(model.SerializeToString())
    with pytest.raises(PolicyError, match="outside its folder"):
        import_policy(path, tmp_path / "out")


def test_motion_file_of_the_wrong_width_is_refused(tmp_path):
    folder = made.unitree_velocity(tmp_path / "dance", history=1, terms="  motion_command: {}\n")
    np.savetxt(folder / "params" / "motion.csv", np.zeros((100, 12)), delimiter=",")
    with pytest.raises(PolicyError, match="5 joint columns; 29"):
        import_policy(folder, tmp_path / "out")


def test_manifest_that_escapes_its_folder_is_refused(tmp_path):
    manifest = import_policy(made.mjlab_velocity(tmp_path / "walker.onnx"), tmp_path / "out")
    path = manifest.folder / "manifest.toml"
    path.write_text(path.read_text().replace('"golden.npz"', '"../../walker.onnx"'))
    with pytest.raises(PolicyError, match="outside the skill's folder"):
        load_manifest(path)


def test_changed_behaviour_is_noticed_by_the_golden_vectors(tmp_path):
    manifest = import_policy(made.mjlab_velocity(tmp_path / "walker.onnx"), tmp_path / "out")
    path = manifest.folder / "manifest.toml"
    lines = path.read_text().splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith("joint_names"))
    swapped = "\n".join(lines)
    assert '"left_hip_pitch_joint"' in swapped and at
    for a, b in (
        ("left_hip_pitch_joint", "TEMP"),
        ("right_hip_pitch_joint", "left_hip_pitch_joint"),
        ("TEMP", "right_hip_pitch_joint"),
    ):
        swapped = swapped.replace(f'"{a}"', f'"{b}"')
    path.write_text(swapped + "\n")
    with pytest.raises(ControlError, match="deviates by"):
        verify_golden(NetworkSkill(load_manifest(path)))


def test_unknown_format_says_what_is_known(tmp_path):
    nodes, weights = made.linear(10, 3)
    path = made.save(tmp_path / "x.onnx", nodes, {"obs": [1, 10]}, {"actions": [1, 3]}, weights)
    with pytest.raises(PolicyError, match="not of a known format.*BeyondMimic.*holosoma"):
        import_policy(path, tmp_path / "out")


def test_folder_with_several_policies_lists_them(tmp_path):
    for name in ("a", "b"):
        made.mjlab_velocity(tmp_path / "many" / f"{name}.onnx")
    with pytest.raises(PolicyError, match="name one of a.onnx, b.onnx"):
        import_policy(tmp_path / "many", tmp_path / "out")


def test_import_does_not_replace_one_of_our_skills_unasked(tmp_path):
    path = made.mjlab_velocity(tmp_path / "waltz.onnx")
    assert import_policy(path, tmp_path / "out").name == "imported_waltz"
    assert import_policy(path, tmp_path / "out", name="waltz").name == "waltz"
