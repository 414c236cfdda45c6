"""Adapt the embedded recogniser's acoustic model to synthetic voices, beside the human one.

`python -m downbeat.tools.adapt_recogniser` speaks the calibration sentences with voices of its own
(never the test half's voices nor its sentences), lays the known words over the sound and moves
every Gaussian towards what it was responsible for (maximum a posteriori). The recogniser keeps the
model as it was made, from people, and hears every utterance with the one that explains it better.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from downbeat.perception.acoustic_model import (
    SILENCE,
    STATES,
    VOICE_FILE,
    AcousticModel,
    load_acoustic_model,
    packaged_folder,
)
from downbeat.perception.cepstra import cepstra, dithered, mel_spectrum, streams, without_noise
from downbeat.perception.features import F32
from downbeat.perception.phone_network import Chain, Columns, Network, best_states, place, search
from downbeat.perception.recogniser_network import Dictionary
from downbeat.tools.recogniser_items import in_noise, items, speak

SNRS_DB = (30.0, 20.0, 12.0)
PRIOR_FRAMES = 20.0
"""A Gaussian that explains so many frames goes half the way."""
_SCALE = np.float32(0.25)
_PAUSE = -3.0


@dataclasses.dataclass
class Statistics:
    """What every Gaussian explained.

    Attributes:
        frames: (phones, streams, densities).
        sums: (phones, streams, densities, 13) of the features.
    """

    frames: NDArray[np.float64]
    sums: NDArray[np.float64]

    def add(
        self,
        model: AcousticModel,
        features: F32,
        senones: NDArray[np.int64],
        phones: NDArray[np.int64],
    ) -> None:
        """Share every frame among the Gaussians of its phone.

        Args:
            model: The one that aligned.
            features: (t, 3, 13).
            senones: (t,).
            phones: (t,).
        """
        column = np.argsort(model.order)  # of a senone in the weights
        for phone in np.unique(phones):
            at = np.flatnonzero(phones == phone)
            for stream in range(features.shape[1]):
                x = features[at, stream]
                away = x[:, None] - model.means[phone, stream]
                density = model.offsets[phone, stream] - 0.5 * (
                    away**2 * model.precisions[phone, stream]
                ).sum(axis=2)
                share = density + np.log(model.weights[stream][:, column[senones[at]]].T + 1e-30)
                share = np.exp(share - share.max(axis=1, keepdims=True))
                share /= share.sum(axis=1, keepdims=True)
                self.frames[phone, stream] += share.sum(axis=0)
                self.sums[phone, stream] += share.T @ x


def align(
    model: AcousticModel, dictionary: Dictionary, text: str, features: F32
) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the senone and the phone of every frame, (t,) each, if the text is what is said.

    Returns:
        None where the sound is too short for it.
    """
    columns = Columns(model)
    silence = model.phones.index(SILENCE)
    pause = [columns.column((silence * STATES + k,)) for k in range(STATES)]
    words = text.split()
    chains, spoken = [], []
    for hub in range(len(words) + 1):
        weight = 0.0 if hub in (0, len(words)) else _PAUSE
        chains.append(Chain(pause, [silence] * STATES, hub, hub, weight, ""))
        spoken.append([silence])
    for hub, word in enumerate(words):
        for (way,) in dictionary.ways(word):
            states, phones = columns.chain([way], [silence], [silence])
            chains.append(Chain(states, phones, hub, hub + 1, 0.0, str(len(spoken))))
            spoken.append(way)
    likelihoods = model.log_likelihoods(features) * _SCALE
    scores = columns.select(likelihoods)
    found = search(Network(model, chains), scores)
    if found.hubs[-1, len(words)] < -1e8:
        return None
    path = found.path(len(scores), len(words))
    sequence = [
        (phone, place(at, len(way)))
        for part in path
        for way in [spoken[int(part.label)] if part.label else [silence]]
        for at, phone in enumerate(way)
    ]
    return _states(model, sequence, likelihoods, silence)


def _states(
    model: AcousticModel, sequence: list[tuple[int, str]], likelihoods: F32, silence: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    numbers = [silence, *(phone for phone, _ in sequence), silence]
    senones = np.array(
        [
            model.senones(phone, numbers[at], numbers[at + 2], where)
            for at, (phone, where) in enumerate(sequence)
        ]
    ).reshape(-1)
    phones = np.repeat(numbers[1:-1], STATES)
    if len(senones) > len(likelihoods):
        return None
    kind = np.arange(len(phones)) % STATES
    path = best_states(likelihoods[:, senones], model.stay[phones, kind], model.leave[phones, kind])
    return senones[path], phones[path]


def spoken(seed: int = 5) -> Iterator[tuple[str, F32]]:
    """Yield the text and the (t, 3, 13) features of the calibration half, in noise."""
    rng = np.random.default_rng(seed)
    for at, item in enumerate(items("adaptation")):
        if item.kind == "language":
            continue
        voice = speak(item.text, item.voice, item.words_per_minute)
        sound = in_noise(voice, SNRS_DB[at % len(SNRS_DB)], rng, pink=bool(at % 2))
        yield item.text, streams(cepstra(without_noise(mel_spectrum(dithered(sound)))))


def adapted_means(
    model: AcousticModel, dictionary: Dictionary, utterances: Iterable[tuple[str, F32]]
) -> tuple[F32, int]:
    """Return the means after adaptation, and of how many frames."""
    known = Statistics(np.zeros(model.means.shape[:3]), np.zeros(model.means.shape))
    count = 0
    for text, features in utterances:
        if (found := align(model, dictionary, text, features)) is not None:
            known.add(model, features, *found)
            count += len(features)
    weight = known.frames[..., None]
    means = (PRIOR_FRAMES * model.means + known.sums) / (PRIOR_FRAMES + weight)
    return means.astype(np.float32), count


def main() -> None:
    """Adapt and freeze."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    folder = packaged_folder()
    model = load_acoustic_model(folder / "en-us")
    dictionary = Dictionary(folder / "cmudict-en-us.dict", model)
    means, count = adapted_means(model, dictionary, spoken())
    moved = (means - model.means).astype(np.float16)
    np.savez_compressed(VOICE_FILE, moved=moved)
    print(f"{VOICE_FILE.name}: {count} frames, {VOICE_FILE.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
