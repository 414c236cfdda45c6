"""Exported CLAPs answer as torch does, from the waveform to the unit vector."""

from __future__ import annotations

import importlib.util
import json

import numpy as np
import pytest
import random_clap as rc

from downbeat.perception.clap_features import FrontEnd, clap_picture, slaney_weights
from downbeat.perception.clap_model import ClapEmbedder
from downbeat.perception.errors import PerceptionError
from downbeat.perception.likeness import CatalogLikeness
from downbeat.perception.likeness_build import build_likeness
from downbeat.perception.source import Recording
from downbeat.tools.errors import ToolError

TOLERANCE = 1e-4


def needs(*packages: str) -> None:
    for package in packages:
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed (extra `models`, requirements-clap.txt)")


@pytest.mark.slow  # importing librosa
def test_front_end_agrees_with_librosa_within_a_thousandth_of_a_decibel():
    import librosa

    front = FrontEnd()
    sound = rc.some_sound(0, 10.0, 48_000)
    power = np.abs(librosa.stft(sound, n_fft=1024, hop_length=480, pad_mode="reflect")) ** 2
    mel = librosa.filters.mel(sr=48_000, n_fft=1024, n_mels=64, fmin=50.0, fmax=14_000.0)
    wanted = 10.0 * np.log10(np.maximum(mel @ power, 1e-10)).T
    np.testing.assert_allclose(slaney_weights(front).T, mel, atol=1e-6)
    np.testing.assert_allclose(clap_picture(sound, 48_000, front), wanted, atol=1e-3)


def test_short_sound_is_repeated_whole_and_long_sound_is_cut_to_the_newest():
    front = FrontEnd()
    sound = rc.some_sound(1, 12.0, 48_000)
    newest = clap_picture(sound[-480_000:], 48_000, front)
    np.testing.assert_array_equal(clap_picture(sound, 48_000, front), newest)
    short = sound[: 4 * 48_000]
    twice = np.concatenate([short, short, np.zeros(2 * 48_000, np.float32)])
    repeated = clap_picture(short, 48_000, front)
    np.testing.assert_array_equal(repeated, clap_picture(twice, 48_000, front))
    assert repeated.shape == (1001, 64)


@pytest.mark.parametrize(
    "content", ["{", "[]", '{"format": "other"}', '{"format": "downbeat-clap-1"}']
)
def test_foreign_folder_is_refused_with_the_command_that_makes_one(tmp_path, content):
    with pytest.raises(PerceptionError, match="models export clap"):
        ClapEmbedder(tmp_path)
    (tmp_path / "clap.json").write_text(content)
    with pytest.raises(PerceptionError, match="models export clap"):
        ClapEmbedder(tmp_path)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_clap_model_of_transformers_is_exported_with_parity(tmp_path, capsys):
    needs("torch", "transformers", "tokenizers")
    import torch

    from downbeat.tools.models_clap import export_clap_command

    model, extractor, tokenizer = rc.make_clap_model(tmp_path / "hf")
    assert export_clap_command(str(tmp_path / "hf"), tmp_path / "clap", "") == 0
    exported = ClapEmbedder(tmp_path / "clap")

    def wanted(sound: np.ndarray) -> np.ndarray:
        seen = extractor(sound, sampling_rate=48_000, return_tensors="pt")
        with torch.no_grad():
            return model.get_audio_features(seen["input_features"].float()).pooler_output[0].numpy()

    check_sound(exported, wanted)
    coded = tokenizer(rc.WORDS, padding=True, return_tensors="pt")
    with torch.no_grad():
        words = model.get_text_features(coded["input_ids"], coded["attention_mask"]).pooler_output
    check_words(exported, words.numpy())
    check_catalogue(exported, tmp_path)
    damage(tmp_path / "clap")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("architecture", ["HTSAT-tiny", "HTSAT-base"])
def test_laion_clap_checkpoint_is_exported_with_parity(tmp_path, capsys, architecture):
    needs("torch", "transformers", "tokenizers", "laion_clap", "torchlibrosa", "h5py")
    import torch

    from downbeat.tools.models_clap import export_clap_command

    model = rc.make_laion_checkpoint(tmp_path / "laion.pt", architecture)
    tokenizer = rc.make_tokenizer(tmp_path / "words")
    arguments = (str(tmp_path / "laion.pt"), tmp_path / "clap", str(tmp_path / "words"))
    assert export_clap_command(*arguments) == 0
    exported = ClapEmbedder(tmp_path / "clap")

    def wanted(sound: np.ndarray) -> np.ndarray:
        # laion-clap's own spectrogram; rounding to 16 bit and repeating happen in its data code.
        sound = (np.clip(sound, -1, 1) * 32767.0).astype(np.int16) / np.float32(32767.0)
        wave = torch.from_numpy(np.tile(sound, 480_000 // len(sound)))
        wave = torch.nn.functional.pad(wave, (0, 480_000 - len(wave)))
        with torch.no_grad():
            seen = [{"waveform": wave, "longer": torch.tensor([False])}]
            return model.get_audio_embedding(seen)[0].numpy()

    check_sound(exported, wanted)
    coded = tokenizer(rc.WORDS, padding="max_length", max_length=77, return_tensors="pt")
    with torch.no_grad():
        words = model.get_text_embedding(dict(coded))
    check_words(exported, words.numpy())


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_what_is_no_checkpoint_is_refused_in_a_sentence(tmp_path):
    needs("torch", "transformers")
    import torch

    from downbeat.tools.models_clap import export_clap_command

    with pytest.raises(ToolError, match="cannot be loaded as a ClapModel"):
        export_clap_command(str(tmp_path), tmp_path / "out", "")
    other = tmp_path / "other.pt"
    torch.save({"layer.weight": torch.zeros(3)}, other)
    with pytest.raises(ToolError, match="no HTSAT checkpoint"):
        export_clap_command(str(other), tmp_path / "out", "")
    torch.save({"audio_branch.patch_embed.mel_conv2d.weight": torch.zeros(3)}, other)
    with pytest.raises(ToolError, match="fused"):
        export_clap_command(str(other), tmp_path / "out", "")
    other.write_bytes(b"not a checkpoint")
    with pytest.raises(ToolError, match="cannot be read"):
        export_clap_command(str(other), tmp_path / "out", "")
    assert not (tmp_path / "out").exists()


def check_sound(exported: ClapEmbedder, wanted) -> None:
    vectors = []
    for seed, seconds in ((0, 5.0), (1, 10.0), (2, 7.3)):
        sound = rc.some_sound(seed, seconds, 48_000)
        found = exported.embed(sound, 48_000)
        assert np.abs(found - wanted(sound)).max() <= TOLERANCE
        vectors.append(found)
    assert np.abs(vectors[0] - vectors[1]).max() > 100 * TOLERANCE  # random weights do listen


def check_words(exported: ClapEmbedder, wanted: np.ndarray) -> None:
    found = exported.embed_texts(rc.WORDS)
    assert np.abs(found - wanted).max() <= TOLERANCE
    assert np.abs(found[0] - found[1]).max() > 100 * TOLERANCE


def check_catalogue(exported: ClapEmbedder, folder) -> None:
    sounds = {
        f"piece{i}": Recording(f"piece{i}", rc.some_sound(i, 11.0, 16_000), 16_000) for i in (1, 2)
    }
    build_likeness(sounds, folder / "likeness.npz", exported)
    from downbeat.perception.likeness_build import load_likeness

    skills = {"salsa": ["salsa", "latin"], "rock": ["rock music"]}
    likeness = load_likeness(folder / "likeness.npz", exported, skills)
    assert isinstance(likeness, CatalogLikeness)
    heard = sounds["piece2"].samples[:80_000]
    assert likeness.nearest(heard, 16_000).track == "piece2"
    ranked = likeness.skills_by_text(heard, 16_000)
    assert sorted(name for name, _ in ranked) == ["rock", "salsa"]
    assert ranked[0][1] >= ranked[1][1]


def damage(folder) -> None:
    header = json.loads((folder / "clap.json").read_text())
    assert set(header["sha256"]) == {"audio.onnx", "text.onnx", "tokenizer.json"}
    (folder / "tokenizer.json").write_text("{}")
    with pytest.raises(PerceptionError, match=r"tokenizer\.json is damaged"):
        ClapEmbedder(folder)
