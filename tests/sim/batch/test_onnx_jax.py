"""Our ONNX evaluator in JAX says what ONNX Runtime says, and says plainly what it cannot."""

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

jax = pytest.importorskip("jax", reason="the extra mjx is not installed")

from downbeat.control.session import open_session  # noqa: E402
from downbeat.policies.manifest import load_skills  # noqa: E402
from downbeat.sim.batch.onnx_jax import JaxGraph  # noqa: E402
from downbeat.sim.errors import SimError  # noqa: E402

SKILLS = load_skills()
RNG_SEED = 5


def save(path, nodes, inputs, outputs, constants=()):
    infos = [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in inputs.items()]
    outs = [helper.make_tensor_value_info(n, TensorProto.FLOAT, None) for n in outputs]
    weights = [numpy_helper.from_array(np.asarray(v), n) for n, v in dict(constants).items()]
    graph = helper.make_graph(nodes, "g", infos, outs, weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 9
    onnx.save(model, path)
    return path


def compare(path, feeds, transform=jax.jit):
    session = open_session(path)
    theirs = session.run(None, feeds)
    graph = JaxGraph(path)
    ours = transform(graph)(feeds)
    for a, b in zip(theirs, ours, strict=True):
        scale = 1.0 + np.abs(a).max()
        assert np.abs(a - np.asarray(b)).max() <= 1e-5 * scale
        assert a.shape == b.shape


@pytest.mark.parametrize("name", sorted(SKILLS))
def test_every_bundled_skill_computes_what_the_runtime_computes(name):
    manifest = SKILLS[name]
    rng = np.random.default_rng(RNG_SEED)
    session = open_session(manifest.onnx_path)
    for _ in range(3):
        feeds = {
            i.name: rng.normal(0.0, 0.4, i.shape).astype(np.float32) for i in session.get_inputs()
        }
        feeds["time_step"][:] = rng.uniform(0.0, manifest.ticks)
        compare(manifest.onnx_path, feeds, lambda graph: graph)


def test_a_normalised_network_with_layer_norm_agrees(tmp_path):
    rng = np.random.default_rng(1)
    weights = {
        "w": rng.normal(size=(12, 24)).astype(np.float32),
        "b": rng.normal(size=12).astype(np.float32),
        "s": rng.uniform(0.5, 1.5, 12).astype(np.float32),
        "o": rng.normal(size=12).astype(np.float32),
    }
    nodes = [
        helper.make_node("Gemm", ["x", "w", "b"], ["h"], transB=1),
        helper.make_node("LayerNormalization", ["h", "s", "o"], ["n"], axis=-1),
        helper.make_node("Elu", ["n"], ["e"]),
        helper.make_node("Softplus", ["e"], ["y"]),
    ]
    path = save(tmp_path / "n.onnx", nodes, {"x": [1, 24]}, ["y"], weights)
    compare(path, {"x": rng.normal(size=(1, 24)).astype(np.float32)})


@pytest.mark.parametrize("kind", ["LSTM", "GRU"])
def test_recurrent_layers_agree_over_many_steps(tmp_path, kind):
    rng = np.random.default_rng(2)
    gates, hidden, width = (4 if kind == "LSTM" else 3), 8, 6
    weights = {
        "w": rng.normal(0, 0.4, (1, gates * hidden, width)).astype(np.float32),
        "r": rng.normal(0, 0.4, (1, gates * hidden, hidden)).astype(np.float32),
        "b": rng.normal(0, 0.2, (1, 2 * gates * hidden)).astype(np.float32),
    }
    state = ["h", "c"] if kind == "LSTM" else ["h"]
    outs = ["y", "hn", "cn"][: 1 + len(state)]
    extra = {} if kind == "LSTM" else {"linear_before_reset": 1}
    nodes = [
        helper.make_node(kind, ["x", "w", "r", "b", "", *state], outs, hidden_size=hidden, **extra)
    ]
    inputs = {"x": [5, 1, width]} | {name: [1, 1, hidden] for name in state}
    path = save(tmp_path / "r.onnx", nodes, inputs, outs, weights)
    feeds = {n: rng.normal(0, 0.5, s).astype(np.float32) for n, s in inputs.items()}
    compare(path, feeds)


def test_a_graph_may_be_mapped_over_robots_and_scanned_over_time():
    manifest = SKILLS["stand"]
    graph = JaxGraph(manifest.onnx_path, ("actions",))
    obs = np.random.default_rng(3).normal(0.0, 0.3, (4, 1, 64)).astype(np.float32)

    def one(robot_obs, tick):
        return graph({"obs": robot_obs, "time_step": jax.numpy.full((1, 1), tick)})[0]

    def step(tick, _):
        return tick + 1, jax.vmap(one, in_axes=(0, None))(obs, tick.astype(np.float32))

    _, actions = jax.jit(lambda: jax.lax.scan(step, jax.numpy.int32(0), None, length=6))()
    session = open_session(manifest.onnx_path)
    for tick in range(6):
        for robot in range(4):
            feeds = {"obs": obs[robot], "time_step": np.float32([[tick]])}
            want = session.run(["actions"], feeds)[0]
            assert np.abs(want - np.asarray(actions[tick, robot])).max() < 1e-5


def test_an_unknown_operator_is_one_sentence_with_node_file_and_what_works(tmp_path):
    nodes = [helper.make_node("Erf", ["x"], ["y"], name="odd")]
    path = save(tmp_path / "odd.onnx", nodes, {"x": [1, 4]}, ["y"])
    with pytest.raises(SimError) as error:
        JaxGraph(path)
    text = str(error.value)
    assert "Erf" in text and "odd" in text and str(path) in text and "Gemm" in text


def test_an_output_that_does_not_exist_is_one_sentence():
    with pytest.raises(SimError, match="outputs are actions"):
        JaxGraph(SKILLS["stand"].onnx_path, ("nothing",))
