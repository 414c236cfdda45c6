"""Small policies in the layouts of the public formats, made by the tests."""

import json
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from downbeat.catalog.robot import load_g1

ROBOT = load_g1()
JOINTS = ROBOT.joint_names
ISAAC = tuple(
    JOINTS[i]
    for i in (
        *(0, 6, 12, 1, 7, 13, 2, 8, 14, 3, 9, 15, 22, 4, 10, 16, 23, 5, 11),
        *(17, 24, 18, 25, 19, 26, 20, 27, 21, 28),
    )
)
MOTION_ROWS = 60
RIGID_23 = (13, 14, 20, 21, 27, 28)
"""Motors that the G1 of 23 joints does not have."""
BODIES = ("pelvis", "torso_link")


def csv(values):
    return ",".join(v if isinstance(v, str) else f"{v:.3f}" for v in values)


def by_name(table, names=ISAAC):
    return [float(table[ROBOT.joint_index(name)]) for name in names]


def save(path, nodes, inputs, outputs, weights, metadata=()):
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in inputs.items()],
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in outputs.items()],
        [numpy_helper.from_array(np.asarray(v, d), n) for n, v, d in weights],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    for key, value in dict(metadata).items():
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, str(path))
    return path


def linear(obs_width, count, obs="obs", actions="actions", seed=0):
    """A network of one layer: (nodes, weights)."""
    rng = np.random.default_rng(seed)
    weights = [
        ("w", rng.normal(scale=0.02, size=(obs_width, count)), np.float32),
        ("b", np.zeros(count), np.float32),
    ]
    return [helper.make_node("Gemm", [obs, "w", "b"], [actions])], weights


def beyondmimic_metadata(**changes):
    table = {
        "joint_names": csv(ISAAC),
        "joint_stiffness": csv(by_name(ROBOT.joint_stiffness)),
        "joint_damping": csv(by_name(ROBOT.joint_damping)),
        "default_joint_pos": csv(by_name(ROBOT.default_joint_pos)),
        "action_scale": csv(by_name(ROBOT.action_scale)),
        "command_names": "motion",
        "observation_names": "command,motion_anchor_ori_b,base_ang_vel,joint_pos,joint_vel,actions",
        "anchor_body_name": "torso_link",
        "body_names": ",".join(BODIES),
    }
    table.update(changes)
    return {key: value for key, value in table.items() if value is not None}


def gathered(tables):
    """Rows of tables, read at `time_step`: (nodes, weights, outputs)."""
    weights = [
        ("last", np.array([MOTION_ROWS - 1.0]), np.float32),
        ("shape", np.array([1]), np.int64),
    ]
    nodes = [
        helper.make_node("Reshape", ["time_step", "shape"], ["flat"]),
        helper.make_node("Min", ["flat", "last"], ["clipped"]),
        helper.make_node("Cast", ["clipped"], ["row"], to=TensorProto.INT64),
    ]
    outputs = {}
    for name, table in tables.items():
        weights.append((f"{name}_table", table, np.float32))
        nodes.append(helper.make_node("Gather", [f"{name}_table", "row"], [name]))
        outputs[name] = [1, *table.shape[1:]]
    return nodes, weights, outputs


def beyondmimic(path, width=154, **changes):
    """A tracking policy with a baked motion of `MOTION_ROWS` rows."""
    nodes, weights = linear(width, 29)
    pos = np.tile(by_name(ROBOT.default_joint_pos), (MOTION_ROWS, 1))
    pos[:, 11] += 0.3 * np.sin(np.linspace(0.0, 3.0, MOTION_ROWS))
    quat = np.zeros((MOTION_ROWS, 2, 4))
    quat[..., 0] = 1.0
    place = np.tile([[0.0, 0.0, 0.75], [0.0, 0.0, 0.79]], (MOTION_ROWS, 1, 1))
    tables = {
        "joint_pos": pos,
        "joint_vel": np.gradient(pos, 0.02, axis=0),
        "body_pos_w": place,
        "body_quat_w": quat,
    }
    table_nodes, table_weights, outputs = gathered(tables)
    nodes, weights = nodes + table_nodes, weights + table_weights
    outputs = {"actions": [1, 29], **outputs}
    inputs = {"obs": [1, width], "time_step": [1, 1]}
    return save(path, nodes, inputs, outputs, weights, beyondmimic_metadata(**changes))


def mjlab_velocity(path, **changes):
    nodes, weights = linear(99, 29)
    changes = {
        "command_names": "twist",
        "observation_names": "base_lin_vel,base_ang_vel,projected_gravity,joint_pos,joint_vel,"
        "actions,command",
        "anchor_body_name": None,
        "body_names": None,
        **changes,
    }
    return save(
        path,
        nodes,
        {"obs": [1, 99]},
        {"actions": [1, 29]},
        weights,
        beyondmimic_metadata(**changes),
    )


def holosoma_tracking(path):
    """holosoma's whole-body tracking: quaternions xyzw, JSON metadata, alphabetical terms."""
    nodes, weights = linear(154, 29)
    pos = np.tile(np.asarray(ROBOT.default_joint_pos), (MOTION_ROWS, 1))
    quat = np.tile([0.0, 0.0, np.sin(0.5), np.cos(0.5)], (MOTION_ROWS, 1))
    tables = {
        "joint_pos": pos,
        "joint_vel": 0.0 * pos,
        "ref_pos_xyz": np.tile([0.0, 0.0, 0.79], (MOTION_ROWS, 1)),
        "ref_quat_xyzw": quat,
    }
    table_nodes, table_weights, outputs = gathered(tables)
    meta = {
        "dof_names": json.dumps(JOINTS),
        "kp": json.dumps([float(v) for v in ROBOT.joint_stiffness]),
        "kd": json.dumps([float(v) for v in ROBOT.joint_damping]),
        "robot_urdf": json.dumps("<robot/>"),
    }
    return save(
        path,
        nodes + table_nodes,
        {"obs": [1, 154], "time_step": [1, 1]},
        {"actions": [1, 29], **outputs},
        weights + table_weights,
        meta,
    )


def holosoma(path, **changes):
    nodes, weights = linear(100, 29, "actor_obs", "action")
    table = {
        "dof_names": str(list(JOINTS)).replace("'", '"'),
        "kp": str([float(v) for v in ROBOT.joint_stiffness]),
        "kd": str([float(v) for v in ROBOT.joint_damping]),
        "command_ranges": '{"lin_vel_x": [-1.0, 1.0], "lin_vel_y": [-1.0, 1.0], '
        '"ang_vel_yaw": [-1.0, 1.0]}',
    }
    table.update(changes)
    meta = {key: value for key, value in table.items() if value is not None}
    return save(path, nodes, {"actor_obs": [1, 100]}, {"action": [1, 29]}, weights, meta)


YAML = """\
joint_ids_map: {ids}
step_dt: 0.02
stiffness: {kp}
damping: {kd}
default_joint_pos: {default}
commands:
  base_velocity:
    ranges: {{lin_vel_x: [-0.5, 1.0], lin_vel_y: [-0.3, 0.3], ang_vel_z: [-0.2, 0.2]}}
actions:
  JointPositionAction:
    clip: null
    scale: {scale}
    offset: {default}
    joint_ids: !!python/object/apply:builtins.slice [null, null, null]
observations:
{terms}"""
VELOCITY_TERMS = {
    "base_ang_vel": (3, 0.2),
    "projected_gravity": (3, 1.0),
    "velocity_commands": (3, 1.0),
    "joint_pos_rel": (29, 1.0),
    "joint_vel_rel": (29, 0.05),
    "last_action": (29, 1.0),
}


def unitree_velocity(folder: Path, history=5, **changes):
    width = 96 * history
    nodes, weights = linear(width, 29)
    save(
        folder / "exported" / "policy.onnx",
        nodes,
        {"obs": [1, width]},
        {"actions": [1, 29]},
        weights,
    )
    terms = "".join(
        f"  {name}: {{params: {{}}, clip: null, scale: {[scale] * count}, "
        f"history_length: {history}}}\n"
        for name, (count, scale) in VELOCITY_TERMS.items()
    )
    values = {
        "ids": [ROBOT.joint_index(name) for name in ISAAC],
        "kp": [float(v) for v in ROBOT.joint_stiffness],
        "kd": [float(v) for v in ROBOT.joint_damping],
        "default": by_name(ROBOT.default_joint_pos),
        "scale": [0.25] * 29,
        "terms": terms,
    }
    text = YAML.format(**{**values, **changes})
    (folder / "params").mkdir(parents=True, exist_ok=True)
    (folder / "params" / "deploy.yaml").write_text(text)
    return folder


def motion_npz(path, count=29, fps=50.0, rows=100, **changes):
    """A motion table as BeyondMimic's tools write it."""
    quat = np.zeros((rows, 3, 4))
    quat[..., 0] = 1.0
    tables = {
        "fps": np.array([fps]),
        "joint_pos": np.zeros((rows, count)),
        "joint_vel": np.zeros((rows, count)),
        "body_pos_w": np.full((rows, 3, 3), 0.8),
        "body_quat_w": quat,
        **changes,
    }
    np.savez(path, **tables)
    return path


def motion_csv(path, rows=300, columns=29):
    """A motion as CSV: base position, quaternion xyzw, joints; the first joint swings."""
    table = np.zeros((rows, 7 + columns))
    table[:, 2], table[:, 6] = 0.8, 1.0
    table[:, 7] = np.linspace(0.0, 1.0, rows)
    np.savetxt(path, table, delimiter=",")
    return path


def unitree_mimic(folder, count=29, **changes):
    """A tracking policy in Unitree's layout, without its motion file."""
    ids = [i for i in (ROBOT.joint_index(n) for n in ISAAC) if count == 29 or i not in RIGID_23]
    width = 2 * count + 6 + 3 + 3 * count
    nodes, weights = linear(width, count)
    network = folder / "exported" / "policy.onnx"
    save(network, nodes, {"obs": [1, width]}, {"actions": [1, count]}, weights)
    names = ("motion_command", "motion_anchor_ori_b", "base_ang_vel", "joint_pos_rel")
    terms = "".join(
        f"  {name}: {{params: {{}}, clip: null, scale: null, history_length: 1}}\n"
        for name in (*names, "joint_vel_rel", "last_action")
    )
    values = {
        "ids": ids,
        "kp": [float(v) for v in ROBOT.joint_stiffness],
        "kd": [float(v) for v in ROBOT.joint_damping],
        "default": [float(ROBOT.default_joint_pos[i]) for i in ids],
        "scale": [0.25] * count,
        "terms": terms,
    }
    (folder / "params").mkdir(parents=True, exist_ok=True)
    (folder / "params" / "deploy.yaml").write_text(YAML.format(**{**values, **changes}))
    return folder


def asap(path):
    """380 observations, 23 actions, no metadata."""
    nodes, weights = linear(380, 23, "actor_obs", "action")
    return save(path, nodes, {"actor_obs": [1, 380]}, {"action": [1, 23]}, weights)


def rl_gym(path, hidden=8):
    """47 observations, 12 actions, one recurrent state that is passed explicitly."""
    rng = np.random.default_rng(0)
    weights = [
        ("w", rng.normal(scale=0.02, size=(47, hidden)), np.float32),
        ("o", rng.normal(scale=0.1, size=(hidden, 12)), np.float32),
    ]
    nodes = [
        helper.make_node("MatMul", ["obs", "w"], ["x"]),
        helper.make_node("Add", ["x", "h_in"], ["sum"]),
        helper.make_node("Tanh", ["sum"], ["h_out"]),
        helper.make_node("MatMul", ["h_out", "o"], ["action"]),
    ]
    return save(
        path,
        nodes,
        {"obs": [1, 47], "h_in": [1, hidden]},
        {"action": [1, 12], "h_out": [1, hidden]},
        weights,
    )
