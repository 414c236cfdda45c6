"""The transformer as a router: its front end, its export, and files that are none of its."""

import json

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from downbeat.perception.errors import PerceptionError
from downbeat.perception.router import MUSIC, SKIP, SPEECH
from downbeat.perception.router_ast import (
    METADATA_KEY,
    AstFront,
    AstModel,
    AstRouter,
    audioset_groups,
    log_mels,
)
from downbeat.tools.errors import ToolError

RATE = 16_000


def sound(seconds=5.0, seed=0):
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    tone = np.sin(2 * np.pi * 330 * t) * (1 + np.sin(2 * np.pi * 4 * t))
    return (0.1 * tone + 0.02 * rng.standard_normal(len(t)) + 0.01).astype(np.float32)


def stand_in_model(path, logits, frames=100):
    """A graph that says the same of every sound, but really reads its input."""
    music, speech, _ = audioset_groups()
    values = np.full(527, -5.0, np.float32)
    for indices, logit in zip((music, speech), logits):
        values[indices[0]] = logit
    nodes = [
        helper.make_node("ReduceMean", ["input_values"], ["mean"], axes=[1, 2], keepdims=1),
        helper.make_node("Mul", ["mean", "nothing"], ["flat"]),
        helper.make_node("Reshape", ["flat", "shape"], ["row"]),
        helper.make_node("Add", ["row", "values"], ["logits"]),
    ]
    graph = helper.make_graph(
        nodes,
        "ast",
        [helper.make_tensor_value_info("input_values", TensorProto.FLOAT, [1, frames, 128])],
        [helper.make_tensor_value_info("logits", TensorProto.FLOAT, [1, 527])],
        [
            helper.make_tensor("nothing", TensorProto.FLOAT, [1], [0.0]),
            helper.make_tensor("shape", TensorProto.INT64, [2], [1, 1]),
            helper.make_tensor("values", TensorProto.FLOAT, [1, 527], values),
        ],
    )
    made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    front = AstFront(128, frames, -4.27, 9.14, music, speech, "stand-in")
    helper.set_model_props(made, {METADATA_KEY: front.as_json()})
    onnx.save(made, path)
    return front


def test_singing_counts_as_music_and_no_label_is_both():
    music, speech, names = audioset_groups()
    assert {27, 32, 36, 137, 282} <= set(music) and not set(music) & set(speech)
    assert set(speech) == set(range(8)) and names[27] == "Singing"


@pytest.mark.parametrize(
    ("logits", "label"), [((3.0, -3.0), MUSIC), ((-3.0, 3.0), SPEECH), ((-4.0, -4.0), SKIP)]
)
def test_the_surest_label_of_each_group_decides(tmp_path, logits, label):
    stand_in_model(tmp_path / "ast.onnx", logits)
    router = AstRouter(AstModel(tmp_path / "ast.onnx"))
    for first in range(0, 3 * RATE, 800):
        router.hear(sound()[first : first + 800], first * 1_000_000 // RATE)
    found = router.judge(0.0)
    assert found.label == label and found.model == "ast" and np.isnan(found.v_frac)
    assert found.p_music == pytest.approx(1 / (1 + np.exp(-logits[0])), abs=1e-6)
    assert router.judge(0.9).label == MUSIC  # a lock that still fits
    router.reset()
    assert router.judge(0.0).label == SKIP


def test_silence_is_skipped_whatever_the_network_says(tmp_path):
    stand_in_model(tmp_path / "ast.onnx", (3.0, -3.0))
    router = AstRouter(AstModel(tmp_path / "ast.onnx"))
    router.hear(np.full(3 * RATE, 0.2, np.float32), 0)  # an offset is no sound
    assert router.judge(0.0).label == SKIP


def test_a_short_window_is_filled_up_with_nothing(tmp_path):
    front = stand_in_model(tmp_path / "ast.onnx", (0.0, 0.0))
    prepared = front.prepare(sound(0.5))[0]
    empty = (0.0 - front.mean) / front.spread
    assert prepared.shape == (100, 128)
    np.testing.assert_allclose(prepared[48:], empty, rtol=1e-6)
    assert np.abs(prepared[:48] - empty).min(axis=1).max() > 0.01


@pytest.mark.parametrize("content", [b"no model", None])
def test_a_file_that_is_no_such_model_is_named_with_the_command_that_makes_one(tmp_path, content):
    path = tmp_path / "x.onnx"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PerceptionError, match=r"x\.onnx.*downbeat models export ast"):
        AstModel(path)


def small_checkpoint(folder, names=None, frames=1024):
    """A small transformer with random weights, in the layout of the published one."""
    torch = pytest.importorskip("torch", reason="torch is not installed (extra `models`)")
    transformers = pytest.importorskip("transformers", reason="transformers is not installed")
    torch.manual_seed(0)
    config = transformers.ASTConfig(
        hidden_size=48, num_hidden_layers=2, num_attention_heads=4, intermediate_size=96,
        max_length=frames, num_mel_bins=128, num_labels=527,
    )  # fmt: skip
    if names:
        config.id2label.update(names)
        config.label2id = {name: index for index, name in config.id2label.items()}
    model = transformers.ASTForAudioClassification(config).eval()
    embeddings = model.audio_spectrogram_transformer.embeddings
    embeddings.position_embeddings.data.normal_(0.0, 0.5)
    for parameter in model.classifier.parameters():
        parameter.data.normal_(0.0, 0.5)
    model.save_pretrained(folder)
    transformers.ASTFeatureExtractor().save_pretrained(folder)
    return torch, transformers, model


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_front_end_equals_that_of_transformers(tmp_path):
    _, transformers, _ = small_checkpoint(tmp_path)
    extractor = transformers.ASTFeatureExtractor.from_pretrained(tmp_path)
    front = AstFront(128, 1024, extractor.mean, 2 * extractor.std, (), (), "")
    for samples in (sound(5.0), sound(12.0)[: 1024 * 160], np.zeros(3 * RATE, np.float32)):
        wanted = extractor(samples, sampling_rate=RATE, return_tensors="np")["input_values"]
        np.testing.assert_allclose(front.prepare(samples), wanted, atol=1e-3)
    assert np.ptp(log_mels(sound(), 128)) > 5.0


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seconds", [10.24, 5.0])
def test_the_exported_transformer_says_what_torch_says(tmp_path, seconds):
    torch, transformers, model = small_checkpoint(tmp_path / "checkpoint")
    from downbeat.tools.models_ast import export_ast

    worst, front = export_ast(str(tmp_path / "checkpoint"), tmp_path / "ast.onnx", seconds)
    assert worst <= 1e-4 and abs(front.seconds - seconds) < 0.03
    exported = AstModel(tmp_path / "ast.onnx")
    assert exported.front == front
    logits = exported.logits(sound(seconds, seed=5))
    assert np.ptp(logits) > 0.1  # not a constant
    if seconds > 10.0:
        extractor = transformers.ASTFeatureExtractor.from_pretrained(tmp_path / "checkpoint")
        fed = extractor(sound(seconds, seed=5), sampling_rate=RATE, return_tensors="pt")
        with torch.no_grad():
            wanted = model(**fed).logits[0].numpy()
        np.testing.assert_allclose(logits, wanted, atol=1e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_interpolated_positions_keep_their_place_in_time(tmp_path):
    """A position that grows with time grows over the same range in a shorter window."""
    torch, _, model = small_checkpoint(tmp_path)
    from downbeat.tools.models_ast import shorten

    embeddings = model.audio_spectrogram_transformer.embeddings
    ramp = torch.linspace(0.0, 1.0, 101).repeat(12)[None, :, None].expand(1, 1212, 48)
    embeddings.position_embeddings.data[:, 2:] = ramp
    special = embeddings.position_embeddings.data[:, :2].clone()
    shorten(model, 498, torch)
    grid = embeddings.position_embeddings.data[0, 2:].reshape(12, 49, 48).numpy()
    assert np.abs(grid[:, :, 0] - np.linspace(0.005, 0.995, 49)).max() < 0.01
    assert torch.equal(embeddings.position_embeddings.data[:, :2], special)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_labels_in_another_order_are_refused(tmp_path):
    small_checkpoint(tmp_path / "checkpoint", names={0: "Music", 137: "Speech"})
    from downbeat.tools.models_ast import export_ast

    with pytest.raises(ToolError, match="Label 0 .* 'Music', in AudioSet it is 'Speech'"):
        export_ast(str(tmp_path / "checkpoint"), tmp_path / "ast.onnx", 5.0)
    assert not (tmp_path / "ast.onnx").exists()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_folder_without_a_checkpoint_is_named(tmp_path):
    pytest.importorskip("transformers", reason="transformers is not installed")
    from downbeat.tools.models_ast import export_ast

    (tmp_path / "config.json").write_text(json.dumps({"model_type": "bert"}))
    with pytest.raises(ToolError, match="holds no Audio Spectrogram Transformer"):
        export_ast(str(tmp_path), tmp_path / "ast.onnx", 5.0)


def test_a_missing_library_is_named(monkeypatch, tmp_path):
    from downbeat.tools import models_ast

    def absent(name):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(models_ast.importlib, "import_module", absent)
    with pytest.raises(ToolError, match="torch is not installed"):
        models_ast.export_ast(str(tmp_path), tmp_path / "ast.onnx", 5.0)
