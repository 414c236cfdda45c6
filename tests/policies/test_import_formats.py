"""Corners of the public formats: motion files, subsets, several inputs, windows, names."""

import os
import shutil
import zipfile

import foreign_policies as made
import numpy as np
import pytest
from onnx import helper

from downbeat.control.errors import ControlError
from downbeat.control.golden import states
from downbeat.control.network import NetworkSkill
from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.package import skill_name
from downbeat.policies.spec_toml import spec_to_table
from downbeat.policies.toml_text import to_toml
from downbeat.tools.cli import main
from downbeat.tools.policy_import import import_policy

ZERO = np.zeros(3, np.float32)


def motion_of(manifest):
    with np.load(manifest.folder / "motion.npz", allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def inferred(manifest, key):
    (line,) = [line for line in manifest.inferred if line.startswith(f"{key} = ")]
    return line


# ---------------------------------------------------------------- motions


def test_csv_motion_is_resampled_to_the_control_rate(tmp_path):
    folder = made.unitree_mimic(tmp_path / "dance")
    made.motion_csv(folder / "params" / "dance_30fps.csv", rows=300)
    manifest = import_policy(folder, tmp_path / "out")
    assert "30: name of dance_30fps.csv" in inferred(manifest, "motion.rate_hz")
    assert manifest.duration_s == pytest.approx(299 / 30, abs=0.03)
    motion = motion_of(manifest)
    hip = manifest.policy.joint_names.index("left_hip_pitch_joint")
    speed = 30 / 299
    assert motion["joint_vel"][:, hip] == pytest.approx(speed, abs=1e-4)
    assert motion["joint_pos"][:, hip] == pytest.approx(
        np.arange(len(motion["joint_pos"])) * 0.02 * speed, abs=1e-4
    )


def test_unknown_rate_of_a_motion_is_asked_for(tmp_path):
    folder = made.unitree_mimic(tmp_path / "dance")
    made.motion_csv(folder / "params" / "dance.csv")
    with pytest.raises(PolicyError, match="does not say motion.rate_hz.*30 or 60"):
        import_policy(folder, tmp_path / "out")
    manifest = import_policy(folder, tmp_path / "out", settings=("motion.rate_hz=60",))
    assert inferred(manifest, "motion.rate_hz").endswith("--set")


def test_known_file_is_played_in_its_authors_window(tmp_path):
    folder = made.unitree_mimic(tmp_path / "dance")
    made.motion_csv(folder / "params" / "G1_Take_102.bvh_60hz.csv", rows=1600)
    manifest = import_policy(folder, tmp_path / "out")
    assert manifest.duration_s == pytest.approx(21.2, abs=0.03)
    assert inferred(manifest, "motion.start_s").endswith("2.8: built-in profile dance_102")
    settings = ("motion.start_s=1.0", "motion.end_s=4.0")
    manifest = import_policy(folder, tmp_path / "out", settings=settings)
    assert manifest.duration_s == pytest.approx(3.0, abs=0.03)


def test_authors_state_machine_says_what_is_played(tmp_path):
    config = tmp_path / "config"
    folder = made.unitree_mimic(config / "policy" / "mimic" / "dance")
    made.motion_csv(folder / "params" / "dance.csv")
    (config / "config.yaml").write_text(
        "FSM:\n  Mimic_Dance:\n    policy_dir: config/policy/mimic/dance/\n"
        "    motion_file: config/policy/mimic/dance/params/dance.csv\n"
        "    fps: 60\n    time_start: 1.0\n    time_end: 3.0\n"
    )
    manifest = import_policy(folder, tmp_path / "out")
    assert manifest.duration_s == pytest.approx(2.0, abs=0.03)
    assert "FSM.Mimic_Dance" in inferred(manifest, "motion.end_s")


def test_motion_tables_are_read(tmp_path):
    folder = made.unitree_mimic(tmp_path / "dance")
    made.motion_npz(folder / "params" / "dance.npz", fps=100.0)
    manifest = import_policy(folder, tmp_path / "out")
    assert manifest.duration_s == pytest.approx(1.0, abs=0.03)
    assert motion_of(manifest)["anchor_pos"][0, 2] == pytest.approx(0.844, abs=1e-3)


def test_mjlab_tracking_without_time_step_takes_the_motion_beside_it(tmp_path):
    nodes, weights = made.linear(154, 29)
    meta = made.beyondmimic_metadata()
    path = tmp_path / "dance.onnx"
    made.save(path, nodes, {"obs": [1, 154]}, {"actions": [1, 29]}, weights, meta)
    with pytest.raises(PolicyError, match="does not say motion.file"):
        import_policy(path, tmp_path / "out")
    made.motion_npz(tmp_path / "dance.npz")
    manifest = import_policy(path, tmp_path / "out")
    assert manifest.policy.time_step_input == ""
    assert manifest.policy.motion.rows == 100


def test_holosoma_tracking_has_its_motion_in_the_graph(tmp_path):
    manifest = import_policy(made.holosoma_tracking(tmp_path / "dance.onnx"), tmp_path / "out")
    assert manifest.kind == "tracking"
    assert manifest.policy.motion.rows == made.MOTION_ROWS
    assert motion_of(manifest)["anchor_quat"][0] == pytest.approx(
        [np.cos(0.5), 0, 0, np.sin(0.5)], abs=1e-6
    )
    assert "holosoma_g1_wbt" in inferred(manifest, "action_scale")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"joint_pos": np.zeros((100, 12))}, "joint_pos is"),
        ({"body_quat_w": np.zeros((100, 3, 4))}, "quaternion of norm 0.00"),
        ({"fps": np.array([0.0])}, "fps is 0"),
        ({"joint_vel": np.full((100, 29), np.nan)}, "not finite"),
        ({"joint_pos": np.array([{"a": 1}], dtype=object)}, "not a table of numbers"),
    ],
)
def test_broken_motion_tables_are_refused(tmp_path, changes, reason):
    folder = made.unitree_mimic(tmp_path / "dance")
    made.motion_npz(folder / "params" / "dance.npz", **changes)
    with pytest.raises(PolicyError, match=reason):
        import_policy(folder, tmp_path / "out")


def test_motion_table_that_unpacks_to_gigabytes_is_refused(tmp_path):
    folder = made.unitree_mimic(tmp_path / "dance")
    path = folder / "params" / "dance.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("joint_pos.npy", "w", force_zip64=True) as member,
    ):
        for _ in range(210):
            member.write(b"\0" * 1_000_000)
    with pytest.raises(PolicyError, match="unpacks to more than"):
        import_policy(folder, tmp_path / "out")


# ---------------------------------------------------------------- subsets and inputs


def test_network_of_23_joints_holds_the_rest_stiffly(tmp_path):
    folder = made.unitree_mimic(tmp_path / "dance", count=23)
    made.motion_csv(folder / "params" / "dance_60hz.csv", columns=23)
    manifest = import_policy(folder, tmp_path / "out")
    held = manifest.policy.held
    assert {made.ROBOT.joint_index(name) for name in held.joint_names} == set(made.RIGID_23)
    assert held.joint_stiffness[held.joint_names.index("waist_pitch_joint")] == 300.0
    hip = manifest.policy.joint_names.index("left_hip_pitch_joint")
    assert motion_of(manifest)["joint_pos"][-1, hip] > 0.9, "columns are in the policy's order"


def test_gains_that_cannot_be_in_motor_order_are_in_the_policys(tmp_path):
    kp = [float(k + 1) for k in range(23)]
    folder = made.unitree_mimic(tmp_path / "dance", count=23, kp=kp)
    made.motion_csv(folder / "params" / "dance_60hz.csv", columns=23)
    manifest = import_policy(folder, tmp_path / "out")
    assert manifest.policy.joint_stiffness == tuple(kp)
    assert "policy's order" in inferred(manifest, "stiffness")


def test_several_named_inputs_are_fed_from_their_groups(tmp_path):
    folder = made.unitree_velocity(tmp_path / "two")
    nodes = [
        helper.make_node("Gemm", ["obs", "w", "b"], ["x"]),
        helper.make_node("MatMul", ["history", "v"], ["y"]),
        helper.make_node("Add", ["x", "y"], ["actions"]),
    ]
    weights = [
        ("w", np.full((9, 29), 0.01), np.float32),
        ("b", np.zeros(29), np.float32),
        ("v", np.full((12, 29), 0.01), np.float32),
    ]
    inputs = {"obs": [1, 9], "history": [1, 12]}
    made.save(folder / "exported" / "policy.onnx", nodes, inputs, {"actions": [1, 29]}, weights)
    config = folder / "params" / "deploy.yaml"
    head = config.read_text().split("observations:")[0]
    config.write_text(
        head + "observations:\n"
        "  obs:\n    base_ang_vel: {params: {}, scale: [0.2, 0.2, 0.2]}\n"
        "    projected_gravity: {params: {}}\n    velocity_commands: {params: {}}\n"
        "  history:\n    use_gym_history: true\n"
        "    base_ang_vel: {params: {}, history_length: 2}\n"
        "    projected_gravity: {params: {}, history_length: 2}\n"
    )
    manifest = import_policy(folder, tmp_path / "out")
    assert [one.name for one in manifest.policy.inputs] == ["obs", "history"]
    skill = NetworkSkill(manifest)
    memory = skill.begin(states()[0], 0.0)
    for state in states()[:2]:
        seen = skill.step(memory, state, 0.0, ZERO).obs
    assert seen[:3] == pytest.approx(states()[1].base_ang_vel * np.float32(0.2))
    assert seen[9:12] == pytest.approx(states()[0].base_ang_vel), "frame by frame, oldest first"
    assert seen[15:18] == pytest.approx(states()[1].base_ang_vel)


def test_clip_after_scaling_is_the_same_clip_before(tmp_path):
    folder = made.unitree_velocity(tmp_path / "velocity", history=1)
    config = folder / "params" / "deploy.yaml"
    text = config.read_text().replace("observations:\n", "observations:\n  scale_first: true\n")
    config.write_text(text.replace("clip: null, scale: [0.2,", "clip: [-1.0, 1.0], scale: [0.2,"))
    spec = import_policy(folder, tmp_path / "out").policy
    (gyro,) = [term for term in spec.inputs[0].terms if term.name == "base_ang_vel"]
    assert gyro.clip == pytest.approx((-5.0, 5.0))


def test_wide_action_clip_is_accepted_and_a_narrow_one_refused(tmp_path):
    folder = made.unitree_velocity(tmp_path / "velocity")
    config = folder / "params" / "deploy.yaml"
    text = config.read_text()
    config.write_text(text.replace("    clip: null\n", f"    clip: {[[-100.0, 100.0]] * 29}\n"))
    assert "wider" in inferred(import_policy(folder, tmp_path / "out"), "action clip")
    config.write_text(text.replace("    clip: null\n", f"    clip: {[[-0.1, 0.1]] * 29}\n"))
    with pytest.raises(PolicyError, match="less than its range"):
        import_policy(folder, tmp_path / "out")


def test_asap_sees_the_four_ticks_before_this_one_newest_first(tmp_path):
    path = made.asap(tmp_path / "kick_level1.onnx")
    manifest = import_policy(path, tmp_path / "out")
    assert manifest.duration_s == pytest.approx(3.96)
    skill = NetworkSkill(manifest)
    memory = skill.begin(states()[0], 0.0)
    rates = [state.base_ang_vel * np.float32(0.25) for state in states()]
    for tick, state in enumerate(states()[:6]):
        seen = skill.step(memory, state, 0.02 * tick, ZERO).obs
        assert seen[23:26] == pytest.approx(rates[tick])
        past = [rates[k] if k >= 0 else ZERO for k in range(tick - 1, tick - 5, -1)]
        start = 72 + 4 * 23  # what is now, then four past actions
        assert seen[start : start + 12] == pytest.approx(np.concatenate(past))
        assert seen[-1] == pytest.approx(0.02 * tick / 3.96)


def test_unknown_asap_motion_needs_a_profile_and_a_length(tmp_path):
    path = made.asap(tmp_path / "mine.onnx")
    with pytest.raises(PolicyError, match="asap_g1_23dof, pbhc_g1_23dof with --profile"):
        import_policy(path, tmp_path / "out")
    with pytest.raises(PolicyError, match="does not say motion.duration_s"):
        import_policy(path, tmp_path / "out", profile="pbhc_g1_23dof")
    manifest = import_policy(
        path, tmp_path / "out", profile="pbhc_g1_23dof", settings=("motion.duration_s=5",)
    )
    assert manifest.duration_s == 5.0


def test_network_without_metadata_is_described_beside_it(tmp_path):
    first = import_policy(made.rl_gym(tmp_path / "lstm.onnx"), tmp_path / "out")
    path = tmp_path / "mine" / "walker.onnx"
    path.parent.mkdir()
    shutil.copy(first.onnx_path, path)
    command = {"vx": [-0.3, 0.3], "vy": [-0.2, 0.2], "yaw_rate": [-0.4, 0.4]}
    table = {"command": command, "policy": spec_to_table(first.policy)}
    path.with_suffix(".toml").write_text(to_toml(table))
    manifest = import_policy(path, tmp_path / "out")
    assert manifest.policy == first.policy
    assert manifest.command.vx == (-0.3, 0.3)


# ---------------------------------------------------------------- nothing guessed, nothing lost


@pytest.mark.parametrize(
    "key", ["joint_names", "joint_stiffness", "default_joint_pos", "observation_names"]
)
def test_missing_metadata_is_named_and_can_be_set(tmp_path, key):
    value = made.beyondmimic_metadata()[key]
    path = made.beyondmimic(tmp_path / "dance.onnx", **{key: None})
    with pytest.raises(PolicyError, match=f"does not say {key}.*--set {key}=VALUE"):
        import_policy(path, tmp_path / "out")
    manifest = import_policy(path, tmp_path / "out", settings=(f"{key}={value}",))
    assert inferred(manifest, key).endswith("--set")
    for wrong in ("-5", "true", "[[1, 2]]", "nan", "", "[]"):
        with pytest.raises(PolicyError):
            import_policy(path, tmp_path / "out", settings=(f"{key}={wrong}",))


@pytest.mark.parametrize(
    ("build", "profile"),
    [
        (made.beyondmimic, "holosoma_g1_29dof"),
        (made.holosoma, "dance_102"),
        (made.holosoma, "holosoma_g1_wbt"),
        (made.unitree_velocity, "dance_102"),
    ],
)
def test_profile_of_another_family_is_refused(tmp_path, build, profile):
    path = build(tmp_path / "policy.onnx")
    with pytest.raises(PolicyError, match=f"'{profile}' does not"):
        import_policy(path, tmp_path / "out", profile=profile)


def test_default_pose_of_another_robot_is_refused(tmp_path):
    pose = ",".join(["3.0"] * 29)
    path = made.beyondmimic(tmp_path / "dance.onnx", default_joint_pos=pose)
    with pytest.raises(PolicyError, match="at 3 rad; the joint's range is"):
        import_policy(path, tmp_path / "out")


def test_policies_of_the_same_name_do_not_replace_each_other(tmp_path):
    one = made.unitree_velocity(tmp_path / "lab_a" / "velocity")
    two = made.unitree_velocity(tmp_path / "lab_b" / "velocity")
    assert import_policy(one, tmp_path / "out").name == "lab_a_velocity"
    assert import_policy(two, tmp_path / "out").name == "lab_b_velocity"
    with pytest.raises(PolicyError, match="not an earlier import.*another --name"):
        import_policy(two, tmp_path / "out", name="lab_a_velocity")
    assert import_policy(one, tmp_path / "out").name == "lab_a_velocity", "again is fine"


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("/a/waltz.onnx", "waltz"),
        ("/a/unitree_rl_lab/velocity", "unitree_rl_lab_velocity"),
        ("/a/g1/config/policy/velocity/v0", "g1_velocity"),
        ("/a/mimic/dance_102/exported/policy.onnx", "dance_102"),
        ("/a/Dance #1.onnx", "dance_1"),
        ("/a/102.onnx", "policy_102"),
        ("/a/CR7_level1/model_191500.onnx", "cr7_level1"),
    ],
)
def test_skill_is_named_after_the_part_of_the_path_that_says_something(path, name):
    from pathlib import Path

    assert skill_name(Path(path)) == name


def test_failed_import_leaves_nothing_and_keeps_what_was_there(tmp_path):
    path = made.mjlab_velocity(tmp_path / "walker.onnx")
    manifest = import_policy(path, tmp_path / "out")
    before = manifest.onnx_path.read_bytes()
    nodes, weights = made.linear(99, 29)
    weights = [(name, value * np.nan, kind) for name, value, kind in weights]
    meta = made.beyondmimic_metadata(
        command_names="twist",
        observation_names="base_lin_vel,base_ang_vel,projected_gravity,joint_pos,joint_vel,"
        "actions,command",
    )
    made.save(path, nodes, {"obs": [1, 99]}, {"actions": [1, 29]}, weights, meta)
    with pytest.raises(ControlError, match="not finite"):
        import_policy(path, tmp_path / "out")
    assert manifest.onnx_path.read_bytes() == before
    assert os.listdir(tmp_path / "out") == ["walker"]


# ---------------------------------------------------------------- hostile files


def test_network_that_may_never_return_is_refused(tmp_path):
    body = helper.make_graph([], "body", [], [])
    nodes, weights = made.linear(47, 12)
    nodes.append(helper.make_node("Loop", ["", ""], [], body=body))
    path = made.save(tmp_path / "x.onnx", nodes, {"obs": [1, 47]}, {"actions": [1, 12]}, weights)
    with pytest.raises(PolicyError, match="operator Loop, whose running time is not bounded"):
        import_policy(path, tmp_path / "out")


def test_network_that_wants_all_memory_is_refused(tmp_path):
    """64 GB of zeros from a file of a kilobyte."""
    path = made.rl_gym(tmp_path / "x.onnx")
    import onnx

    model = onnx.load(str(path))
    model.graph.initializer.append(
        onnx.numpy_helper.from_array(np.array([2**17, 2**17], np.int64), "shape")
    )
    grown = helper.make_node("ConstantOfShape", ["shape"], ["huge"])
    total = helper.make_node("ReduceSum", ["huge"], ["total"], keepdims=0)
    (last,) = [node for node in model.graph.node if "action" in node.output]
    last.output[0] = "before"
    added = helper.make_node("Add", ["before", "total"], ["action"])
    model.graph.node.extend([grown, total, added])
    path.write_bytes(model.SerializeToString())
    with pytest.raises(PolicyError, match="cannot be run"):
        import_policy(path, tmp_path / "out")


@pytest.mark.parametrize("part", ["params/deploy.yaml", "exported/policy.onnx"])
def test_links_that_lead_out_of_the_folder_are_refused(tmp_path, part):
    folder = made.unitree_velocity(tmp_path / "velocity")
    outside = tmp_path / "outside"
    shutil.move(folder / part, outside)
    (folder / part).symlink_to(outside)
    with pytest.raises(PolicyError, match="leads outside the folder"):
        import_policy(folder, tmp_path / "out")


def test_linked_motion_file_is_refused(tmp_path):
    folder = made.unitree_mimic(tmp_path / "dance")
    made.motion_csv(tmp_path / "elsewhere.csv")
    (folder / "params" / "dance_60hz.csv").symlink_to(tmp_path / "elsewhere.csv")
    with pytest.raises(PolicyError, match="leads outside the folder"):
        import_policy(folder, tmp_path / "out")


def test_external_weights_hidden_in_a_node_are_found(tmp_path):
    import onnx

    nodes, weights = made.linear(47, 12)
    tensor = onnx.TensorProto(name="t", data_type=1, dims=[4], data_location=1)
    tensor.external_data.add(key="location", value="/etc/hostname")
    nodes.append(helper.make_node("Constant", [], ["unused"], value=tensor))
    path = made.save(tmp_path / "x.onnx", nodes, {"obs": [1, 47]}, {"actions": [1, 12]}, weights)
    with pytest.raises(PolicyError, match="wants weights from '/etc/hostname', outside"):
        import_policy(path, tmp_path / "out")


def test_wrong_input_is_one_sentence_and_exit_code_2(tmp_path, capsys):
    path = made.beyondmimic(tmp_path / "dance.onnx", joint_damping="x" * 5000)
    assert main(["policy", "import", str(path), "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("downbeat: ") and len(line) < 400


def test_inspect_shows_a_foreign_policy_without_keeping_it(tmp_path, capsys):
    path = made.rl_gym(tmp_path / "lstm.onnx")
    assert main(["policy", "inspect", str(path)]) == 0
    out = capsys.readouterr().out
    for shown in ("gait_phase", "left_knee_joint", "h_in <- h_out", "the same bits", "held"):
        assert shown in out
    assert os.listdir(tmp_path) == ["lstm.onnx"]


def test_names_in_a_file_are_never_taken_for_markup(tmp_path):
    nodes, weights = made.linear(99, 29, obs="[/red]")
    meta = made.beyondmimic_metadata(
        command_names="twist",
        observation_names="base_lin_vel,base_ang_vel,projected_gravity,joint_pos,joint_vel,"
        "actions,command",
    )
    inputs = {"[/red]": [1, 99]}
    path = made.save(tmp_path / "x.onnx", nodes, inputs, {"actions": [1, 29]}, weights, meta)
    assert main(["policy", "inspect", str(path)]) == 0


def test_inspect_shows_an_imported_skill_by_its_folder(tmp_path, capsys):
    manifest = import_policy(made.beyondmimic(tmp_path / "dance.onnx"), tmp_path / "out")
    assert main(["policy", "inspect", str(manifest.folder)]) == 0
    assert "motion_anchor_ori_b" in capsys.readouterr().out
