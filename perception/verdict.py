"""How likely the best fit is right: what speaks for it and against it, cell by cell.

Correlation asks only how alike two spectra are. But noise adds and takes nothing away: where the
reference is loud and the query is not, the place is wrong however well the rest fits; where the
query is loud and the reference is not, somebody talks. So each cell votes with the weight that its
two levels have earned, and the query's own numbers (rival, chance, rate) join them. How much of
the window agrees counts, too: a click is one witness, however alike two clicks are, and so is a
drum that is hit over and over. The weights are learned: logistic regression on windows of known and
of unknown music, of voices, tones, single sounds and drum loops (`python -m
downbeat.tools.train_verdict`, docs/matcher.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from downbeat.perception import features as ft
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.index import QUANTUM, Fine

F64 = npt.NDArray[np.float64]

WEIGHTS = Path(__file__).parent / "data" / "verdict.npz"
FORMAT = 2
LEVEL_STEP, LEVELS = 0.5, 9
"""Features of -1.5 to 3 fall into that many levels."""
USUAL_S, USUAL_FRAMES = 5.0, 62
"""Where the length of a window speaks neither way."""
NUMBERS = (
    "similarity", "second", "margin", "chance", "rate", "pitch", "heard", "known",
    "lasting", "lasting_similarity", "lasting_lead",
    "variety", "variety_similarity", "variety_lead",
)  # fmt: skip
MEASURES = LEVELS * LEVELS + len(NUMBERS)
SIMILARITY, SECOND, LASTING = (
    LEVELS**2 + NUMBERS.index(name) for name in ("similarity", "second", "lasting")
)
WITNESSES = slice(LASTING, MEASURES)
"""Measures of how much agrees: the script learns weights of 0 or more for them, as to agree over
more of the window, or with more different sounds, never speaks against a fit."""
SURE_FROM, SURE_GAIN = 0.3, 20.0
"""What stands so far above the second is sure, and regression cannot learn how sure: of 45,000
windows of strangers, a second long or more, three stood 0.3 above it and none 0.34, or 0.48 if it
was taken for another piece of its composer; right ones stand 0.4 to 0.8 above it where nothing
disturbs."""
BRIEF_BELOW, BRIEF_COST, BRIEF_SURE_FROM = 0.5, 3.0, 0.65
"""Where less than this share of a window agrees (1 window of music in 130), a click or a tone may
be all there is. A tone's first moment stood 0.9 above the second for a piece of single sounds: such
windows are sure only from the last lead on, and pay what twenty times as many strangers of their
kind among the learned ones would make them pay, as a stage with such a piece hears nothing else."""
BARE_BELOW, LEAST_SPECTRA = 0.6, 2.0
"""Where fewer different spectra agree, and less than this share of a window, it may be one note's
beginning; 1 in 200 right windows of two seconds or less is like that."""
_LASTING_FLOOR = 1e-3
_LEVEL_OF_INT8 = np.clip(
    (np.arange(-128, 128) / QUANTUM - ft.CLIP_LOW) / LEVEL_STEP, 0, LEVELS - 1
).astype(np.int64)


@dataclass(frozen=True, slots=True)
class Numbers:
    """What is known of a fit besides its cells.

    Attributes:
        similarity: Of the best fit.
        second: Of the best other track.
        chance: Spread of the scores of all places.
        rate: Track seconds per real second.
        pitch: How much too high the query sounds.
    """

    similarity: float
    second: float
    chance: float
    rate: float
    pitch: float


class Line(NamedTuple):
    """A threshold that falls with the logarithm of the length: short windows meet more chance.

    Attributes:
        at_usual: For a window of 5 s.
        slope: Per natural logarithm of the length.
    """

    at_usual: float
    slope: float

    def of(self, seconds: Any) -> Any:
        """Return the threshold for windows of this length [s]."""
        return self.at_usual + self.slope * np.log(np.asarray(seconds) / USUAL_S)


def measure(query: F32, reference: Fine, numbers: Numbers) -> F64:
    """Return what is weighed, (MEASURES,).

    Args:
        query: (w, NUM_BANDS) features of the query, at the pitch of the fit.
        reference: (w, NUM_BANDS) those of the track, where the fit says.
        numbers: Of the fit.
    """
    heard = np.clip((query - ft.CLIP_LOW) / LEVEL_STEP, 0, LEVELS - 1).astype(np.int64)
    known = _LEVEL_OF_INT8[reference.astype(np.int64) + 128]
    cells = np.bincount((heard * LEVELS + known).ravel(), minlength=LEVELS**2) / heard.size
    power = np.square(reference, dtype=np.float32).mean() / QUANTUM**2
    agreed = agreement(query, reference)
    lasting = math.log(share_that_agrees(agreed) + _LASTING_FLOOR)
    varied = math.log(variety(agreed))
    lead = numbers.similarity - numbers.second
    rest = (
        numbers.similarity,
        numbers.second,
        lead / (numbers.chance + 1e-3) / 10.0,
        numbers.chance * 10.0,
        abs(numbers.rate - 1.0) * 20.0,
        float(numbers.pitch != 1.0),
        float(np.square(query).mean()),
        float(power),
        lasting,
        lasting * numbers.similarity,
        lasting * lead,
        varied,
        varied * numbers.similarity,
        varied * lead,
    )
    return np.concatenate([cells, rest])


def agreement(query: F32, reference: Fine) -> F32:
    """Return where both are louder than around, and how much, (w, NUM_BANDS).

    Args:
        query: (w, NUM_BANDS).
        reference: (w, NUM_BANDS), as in `measure`.
    """
    both = np.maximum(query, 0.0) * np.maximum(reference, 0).astype(np.float32)
    return np.asarray(both, np.float32)


def share_that_agrees(agreed: F32) -> float:
    """Return over how much of a window what agrees is spread, 0..1: 1 / w if it is one frame.

    Args:
        agreed: (w, NUM_BANDS) `agreement`.
    """
    frames = agreed.sum(1)
    most = len(frames) * float(np.square(frames).sum())
    return float(frames.sum()) ** 2 / most if most > 0.0 else 0.0


def variety(agreed: F32) -> float:
    """Return how many different spectra agree, 1 or more: one sound repeated is one.

    The participation ratio of the eigenvalues of the frames' inner products.

    Args:
        agreed: (w, NUM_BANDS) `agreement`.
    """
    products = agreed @ agreed.T
    most = float(np.square(products).sum())
    return max(float(np.trace(products)) ** 2 / most, 1.0) if most > 0.0 else 1.0


def is_bare(agreed: F32) -> bool:
    """Say whether what agrees may be the beginning of one note: any test tone of its pitch has it.

    Args:
        agreed: (w, NUM_BANDS) `agreement`.
    """
    return share_that_agrees(agreed) < BARE_BELOW and variety(agreed) < LEAST_SPECTRA


def with_length(measures: F64, frames: npt.NDArray[np.int64] | int) -> F64:
    """Return measures twice, the second time by how much longer than usual the window is.

    Args:
        measures: (..., MEASURES).
        frames: (...) of the windows.
    """
    longer = np.log(np.asarray(frames) / USUAL_FRAMES)[..., None]
    return np.concatenate([measures, measures * longer, longer], axis=-1)


def certainty(measures: F64) -> F64:
    """Return what is added to the log-odds for what regression cannot learn, (...).

    Args:
        measures: (..., MEASURES) or longer rows that begin with them.
    """
    share = np.exp(measures[..., LASTING]) - _LASTING_FLOOR
    brief = 1.0 - np.minimum(share / BRIEF_BELOW, 1.0)
    lead = measures[..., SIMILARITY] - measures[..., SECOND]
    needed = SURE_FROM + (BRIEF_SURE_FROM - SURE_FROM) * brief
    return np.asarray(SURE_GAIN * np.maximum(lead - needed, 0.0) - BRIEF_COST * brief)


class Verdict:
    """The learned weights.

    Attributes:
        accept: A window alone is accepted above this.
        lock: And is enough for a lock above this: a listener that is lost asks 40,000 windows an
            hour, and each may be wrong.
    """

    def __init__(self, path: Path = WEIGHTS) -> None:
        """Read the weights.

        Raises:
            PerceptionError: The file is missing or of another format.
        """
        try:
            with np.load(path) as file:
                if int(file["format"]) != FORMAT or len(file["weights"]) != 2 * MEASURES + 1:
                    raise ValueError("another format")
                self._weights, self._bias = file["weights"].astype(np.float64), float(file["bias"])
                self.accept, self.lock = (
                    Line(*map(float, file[name])) for name in ("accept", "lock")
                )
        except (OSError, KeyError, ValueError, TypeError) as error:
            raise PerceptionError(
                f"The matcher's weights {path} cannot be read ({error}); valid is format {FORMAT}, "
                "written by `python -m downbeat.tools.train_verdict`."
            ) from error

    def log_odds(self, query: F32, reference: Fine, numbers: Numbers) -> float:
        """Return how likely a fit is right: the logarithm of its odds; arguments: `measure`."""
        measures = measure(query, reference, numbers)
        longer = math.log(len(query) / USUAL_FRAMES)
        plain, stretched = self._weights[:MEASURES], self._weights[MEASURES:-1]
        weighed = float(measures @ (plain + longer * stretched))
        weighed += float(self._weights[-1]) * longer + self._bias
        return weighed + float(certainty(measures))


@lru_cache(maxsize=1)
def learned() -> Verdict:
    """Return the weights that come with Downbeat, read once."""
    return Verdict()
