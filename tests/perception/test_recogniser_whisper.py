"""Whisper weights on this machine: a tiny random model is loaded, hears and never raises."""

import math

import numpy as np
import pytest

pytest.importorskip("torch")
transformers = pytest.importorskip("transformers")

from downbeat.perception.errors import PerceptionError  # noqa: E402 - needs the extra
from downbeat.perception.recognisers import RecogniserConfig, make_recogniser  # noqa: E402

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
SPECIAL = ("<|endoftext|>", "<|startoftranscript|>", "<|en|>", "<|transcribe|>", "<|notimestamps|>")


def byte_letters():
    """Return the 256 letters that stand for bytes in a byte-level vocabulary."""
    plain = [*range(33, 127), *range(161, 173), *range(174, 256)]
    shifted = [value for value in range(256) if value not in plain]
    return [chr(v) for v in plain] + [chr(256 + at) for at in range(len(shifted))]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Save a Whisper of 0.1 million random weights, with its tokenizer, as the hub would."""
    import torch

    out = tmp_path_factory.mktemp("whisper")
    vocab = {letter: at for at, letter in enumerate(byte_letters())}
    vocab |= {name: 256 + at for at, name in enumerate(SPECIAL)}
    tokenizer = transformers.WhisperTokenizer(
        vocab=vocab, merges=[], unk_token=SPECIAL[0], bos_token=SPECIAL[0], eos_token=SPECIAL[0]
    )
    tokenizer.add_special_tokens({"additional_special_tokens": list(SPECIAL[1:])})
    torch.manual_seed(0)
    config = transformers.WhisperConfig(
        vocab_size=len(tokenizer), d_model=32, encoder_layers=1, decoder_layers=1,
        encoder_attention_heads=2, decoder_attention_heads=2, encoder_ffn_dim=32,
        decoder_ffn_dim=32, num_mel_bins=80, max_target_positions=32, pad_token_id=256,
        bos_token_id=256, eos_token_id=256, decoder_start_token_id=257, suppress_tokens=None,
        begin_suppress_tokens=None,
    )  # fmt: skip
    model = transformers.WhisperForConditionalGeneration(config)
    model.generation_config.max_length = 16
    model.save_pretrained(out)
    tokenizer.save_pretrained(out)
    transformers.WhisperFeatureExtractor(feature_size=80).save_pretrained(out)
    return out


@pytest.fixture(scope="module")
def whisper(folder):
    return make_recogniser(RecogniserConfig("whisper", model=str(folder)), ())


def test_local_weights_answer_with_words_and_no_failure(whisper):
    sound = (0.1 * np.random.default_rng(0).standard_normal(24_000)).astype(np.float32)
    heard = whisper.recognise(sound)
    assert (heard.backend, heard.failure) == ("whisper", "")
    assert heard.words == tuple(heard.text.split())
    assert math.isnan(heard.confidence) and heard.compute_us > 0
    assert whisper.recognise(sound).text == heard.text


@pytest.mark.parametrize("seconds", [0.0, 0.05, 1.0])
def test_silence_is_nothing(whisper, seconds):
    assert whisper.recognise(np.zeros(round(seconds * 16_000), np.float32)).text == ""


def test_a_monologue_is_cut_and_answered(whisper):
    sound = (0.1 * np.random.default_rng(1).standard_normal(16_000 * 40)).astype(np.float32)
    assert whisper.recognise(sound).failure == ""


def test_what_is_no_folder_of_weights_is_said_so(tmp_path):
    with pytest.raises(PerceptionError, match="cannot be loaded"):
        make_recogniser(RecogniserConfig("whisper", model=str(tmp_path)), ())
