import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

from downbeat.catalog.errors import CatalogError
from downbeat.catalog.mjcf import ModelOptions, g1_mjcf
from downbeat.catalog.robot import load_facts, load_g1

REFERENCE = json.loads((Path(__file__).parent / "data" / "g1_reference_dynamics.json").read_text())


def build(**options):
    return mujoco.MjModel.from_xml_string(g1_mjcf(ModelOptions(**options)))


@pytest.fixture(scope="module")
def model():
    return build()


def test_total_mass_is_that_of_the_facts(model):
    assert model.body_mass.sum() == pytest.approx(33.341, abs=5e-4)
    assert model.body_mass.sum() == pytest.approx(REFERENCE["total_mass"], rel=1e-9)


def assert_close_to_reference(actual, expected):
    """1e-6 relative to the quantity's own size: single entries may be differences of large ones."""
    expected = np.asarray(expected)
    np.testing.assert_allclose(actual, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("configuration", REFERENCE["configurations"])
def test_dynamics_agree_with_the_reference(configuration):
    model = build(armature_scale=0.0, visual=False)
    data = mujoco.MjData(model)
    data.qpos[:] = configuration["qpos"]
    data.qvel[:] = configuration["qvel"]
    mujoco.mj_forward(model, data)
    mass_matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass_matrix)
    assert_close_to_reference(np.diag(mass_matrix), configuration["mass_matrix_diag"])
    assert_close_to_reference(mass_matrix[6], configuration["mass_matrix_row_6"])
    assert np.linalg.norm(mass_matrix) == pytest.approx(
        configuration["mass_matrix_frobenius"], rel=1e-6
    )
    assert_close_to_reference(data.qfrc_bias, configuration["bias"])
    assert_close_to_reference(data.subtree_com[1], configuration["com"])


def test_joints_and_actuators_are_in_motor_order(model):
    robot = load_g1()
    joints = [model.joint(i).name for i in range(1, model.njnt)]
    actuators = [model.actuator(i).name for i in range(model.nu)]
    assert tuple(joints) == tuple(actuators) == robot.joint_names
    np.testing.assert_array_equal(model.actuator_gainprm[:, 0], robot.joint_stiffness)
    np.testing.assert_array_equal(model.actuator_forcerange[:, 1], robot.effort_limit)
    np.testing.assert_array_equal(model.dof_armature[6:], robot.joint_armature)


def test_solver_settings_are_those_of_the_generator(model):
    option = model.opt
    assert option.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert option.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    assert option.solver == mujoco.mjtSolver.mjSOL_NEWTON
    assert option.disableflags == mujoco.mjtDisableBit.mjDSBL_AUTORESET
    assert option.iterations == 100
    assert option.timestep == 0.005


def test_looks_do_not_change_the_physics():
    plain, pretty = build(visual=False), build(visual=True)
    for name in ("body_mass", "body_inertia", "body_ipos", "dof_armature", "exclude_signature"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(pretty, name))
    collides = (pretty.geom_contype != 0) | (pretty.geom_conaffinity != 0)
    assert collides.sum() == plain.ngeom
    trajectories = []
    for model in (plain, pretty):
        data = mujoco.MjData(model)
        data.ctrl[:] = load_g1().default_joint_pos
        for _ in range(200):
            mujoco.mj_step(model, data)
        trajectories.append(data.qpos.copy())
    np.testing.assert_array_equal(*trajectories)


def test_only_the_soles_feel_friction(model):
    for index in range(model.ngeom):
        name = model.geom(index).name
        if "_foot" in name:
            assert model.geom_condim[index] == 3
            assert model.geom_priority[index] == 1
        elif name.endswith("_collision"):
            assert model.geom_condim[index] == 1


def test_every_side_has_four_contact_spheres(model):
    for side in ("left", "right"):
        names = [model.geom(i).name for i in range(model.ngeom)]
        assert sum(name.startswith(f"{side}_foot") for name in names) == 4


def test_collision_shapes_are_hidden_unless_asked_for():
    hidden, shown = build(), build(show_collision=True)
    index = hidden.geom("torso_collision").id
    assert hidden.geom_group[index] == 3
    assert shown.geom_group[shown.geom("torso_collision").id] <= 2


def test_a_mesh_folder_without_the_files_is_answered_with_their_names(tmp_path):
    with pytest.raises(CatalogError, match="pelvis.STL"):
        g1_mjcf(ModelOptions(mesh_dir=tmp_path))


def test_meshes_replace_the_shells_and_leave_the_physics(tmp_path):
    triangle = np.array(
        [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype="<f4"
    )  # a tetrahedron
    faces = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))
    stl = b"\0" * 80 + np.uint32(len(faces)).tobytes()
    for face in faces:
        stl += np.zeros(3, "<f4").tobytes() + triangle[list(face)].tobytes() + b"\0\0"
    for mesh in load_facts()["visual_meshes_optional"]:
        (tmp_path / mesh["file"]).write_bytes(stl)
    model = build(mesh_dir=tmp_path)
    assert (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH).sum() == 35
    assert model.body_mass.sum() == pytest.approx(REFERENCE["total_mass"], rel=1e-9)


def test_the_model_text_needs_no_mujoco():
    code = (
        "import sys; from downbeat.catalog.mjcf import g1_mjcf; g1_mjcf();"
        "print('mujoco' in sys.modules)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "False"
