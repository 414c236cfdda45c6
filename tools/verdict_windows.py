"""Windows of known and of unknown music, as the matcher sees them: what the verdict learns from.

Every sound is asked twice, of the whole catalogue and of one that lacks its track, at several
lengths. Tracks that share a passage with it are no strangers and are left out both times. Pieces
of single sounds and pauses are put among the tracks; voices, tones, noise and other such pieces
are asked, too.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from downbeat.perception import features as ft
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import F32
from downbeat.perception.index import Index
from downbeat.perception.matcher import AlignmentMatcher
from downbeat.perception.source import Recording
from downbeat.tools import conditions as cd
from downbeat.tools.chunks_folder import RATE_HZ, make_index, read_folder, read_groups, read_tracks
from downbeat.tools.chunks_make import Query, is_silent, recombined
from downbeat.tools.chunks_score import ConditionScore, Places
from downbeat.tools.conditions import Degradation
from downbeat.tools.matcher_sounds import make_babble, synthetic_sounds, white_noise
from downbeat.tools.passages import find_passages
from downbeat.tools.sparse_sounds import sparse_pieces

LENGTHS_S = (1.0, 1.25, 2.0, 3.0, 5.0, 8.0)
LENGTHS_PER_SOUND = 3
SOUND_S, BEFORE_S, AFTER_S = 8.0, 1.0, 1.5
SMALL_CATALOGUE, SMALL_SHARE = 8, 0.25
"""A quarter of the strangers is asked of a catalogue of so many tracks."""
LOUDEST_DB, SOFTEST_DB = -5.0, 10.0
"""Of noise and voices: music above them."""
SPARSE, SPARSE_STRANGERS = 8, 16
"""Pieces of single sounds and pauses that join the catalogue, and others that nobody knows."""


@dataclass
class Windows:
    """What was asked, one row per query.

    Attributes:
        measures: (n, MEASURES).
        frames: (n,) lengths.
        is_right: (n,) the best fit is the track and place that play.
        is_known: (n,) the catalogue holds the track.
        is_kin: (n,) taken for another piece of the same group.
        condition: (n,) names.
        track: (n,) names.
    """

    measures: list[npt.NDArray[np.float64]] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    is_right: list[bool] = field(default_factory=list)
    is_known: list[bool] = field(default_factory=list)
    is_kin: list[bool] = field(default_factory=list)
    condition: list[str] = field(default_factory=list)
    track: list[str] = field(default_factory=list)

    def arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """Return all as arrays by name."""
        return {name: np.array(getattr(self, name)) for name in self.__dataclass_fields__}


def random_condition(babbles: Sequence[F32], rng: np.random.Generator) -> Degradation:
    """Draw what is done to a sound: as it is, coded, in a room, in noise, among people, faster."""
    db = float(rng.uniform(LOUDEST_DB, SOFTEST_DB))
    babble = babbles[int(rng.integers(len(babbles)))] if babbles else None
    known = {d.name: d for d in cd.degradations(babble)}
    drawn = float(rng.random())
    if babble is not None and drawn < 0.25:
        return Degradation("babble", cd.voices(babble, db))
    if babble is not None and drawn < 0.45:
        return known["robot"]
    if drawn < 0.6:
        return Degradation("pink", cd.pink(db))
    if drawn < 0.68:
        return Degradation("white", white_noise(db))
    if drawn < 0.8:
        return known["clean"]
    names = [n for n in known if not n.startswith(("babble", "pink", "white", "clean", "robot"))]
    return known[names[int(rng.integers(len(names)))]]


def sounds(
    recording: Recording, count: int, babbles: Sequence[F32], rng: np.random.Generator
) -> Iterator[Query]:
    """Cut sounds of 8 s anywhere in a recording, each as heard in a condition drawn for it."""
    rate = recording.sample_rate_hz
    for _ in range(count):
        last_s = max(recording.duration_s - SOUND_S, 0.0)
        start_s = float(rng.uniform(0.0, last_s))
        first = round(start_s * rate)
        before = min(first, round(BEFORE_S * rate))
        part = recording.samples[first - before : first + round((SOUND_S + AFTER_S) * rate)]
        degradation = random_condition(babbles, rng)
        heard = degradation.apply(part, rate, rng)
        begin = round(before / degradation.time_factor)
        samples = heard[begin : begin + round(SOUND_S * rate)].astype(np.float32)
        plain = part[before : before + round(SOUND_S * rate)]
        yield Query(degradation.name, recording.name, start_s, 0.0, samples, is_silent(plain))


class VerdictStudy:
    """Asks a folder of recordings about itself."""

    def __init__(self, tracks: Path, speech: Sequence[Path], groups: Path | None) -> None:
        """Decode and index.

        Raises:
            ToolError: Fewer than two recordings that can be indexed.
            PerceptionError: A folder without recordings.
        """
        self.recordings = read_tracks(tracks)
        seed = zlib.crc32(tracks.resolve().name.encode())
        made = sparse_pieces(SPARSE + SPARSE_STRANGERS, seed, RATE_HZ)
        self.recordings |= {piece.name: piece for piece in made[:SPARSE]}
        self.groups = read_groups(groups)
        voices = [read_folder(folder) for folder in speech]
        self.strangers = [
            *made[SPARSE:],
            *synthetic_sounds(),
            *(v for all_ in voices for v in all_),
        ]
        self.babbles = [make_babble([v.samples for v in all_], 30.0, RATE_HZ) for all_ in voices]
        self.index: Index = make_index(self.recordings.values())
        self.index.shared = find_passages(self.index)
        self.places = Places(
            {n: ft.to_matcher_rate(r.samples, RATE_HZ) for n, r in self.recordings.items()}
        )

    def windows(self, count: int, seed: int) -> Windows:
        """Ask `count` sounds of every recording, and its pieces in another order."""
        rows = Windows()
        for number, recording in enumerate(self.recordings.values()):
            rng = np.random.default_rng([seed, zlib.crc32(recording.name.encode())])
            copies = self._copies_of(recording.name)
            names = self.index.names
            rest = [i for i, name in enumerate(names) if i != number and name not in copies]
            if not rest:
                continue
            few = rng.permutation(rest)[:SMALL_CATALOGUE].tolist()
            own = AlignmentMatcher(self.index.subset([number, *rest]))
            others = AlignmentMatcher(self.index.subset(rest))
            small = AlignmentMatcher(self.index.subset(few))
            for query in sounds(recording, count, self.babbles, rng):
                is_small = rng.random() < SMALL_SHARE
                for seconds in rng.permutation(LENGTHS_S)[:LENGTHS_PER_SOUND].tolist():
                    part = query.samples[: round(seconds * RATE_HZ)]
                    if not query.is_silent:
                        self._ask(rows, own, query, part, is_known=True)
                    stranger = small if is_small else others
                    self._ask(rows, stranger, query, part, is_known=False)
            for music in recombined(recording, seed):
                for query in sounds(music, max(count // 8, 1), [], rng):
                    part = query.samples[: round(float(rng.choice(LENGTHS_S)) * RATE_HZ)]
                    self._ask(rows, others, query, part, is_known=False)
        self._ask_strangers(rows, count, seed)
        return rows

    def _ask_strangers(self, rows: Windows, count: int, seed: int) -> None:
        """Ask what no catalogue holds: voices, tones, noise, single sounds."""
        matcher = AlignmentMatcher(self.index)
        for recording in self.strangers:
            rng = np.random.default_rng([seed, zlib.crc32(recording.name.encode())])
            for query in sounds(recording, count, [], rng):
                for seconds in rng.permutation(LENGTHS_S)[:LENGTHS_PER_SOUND].tolist():
                    part = query.samples[: round(seconds * RATE_HZ)]
                    self._ask(rows, matcher, query, part, is_known=False)

    def _copies_of(self, name: str) -> set[str]:
        """Return the tracks that share a passage with one."""
        pairs = [(p.one, p.other) for p in self.index.shared or ()]
        return {b if a == name else a for a, b in pairs if name in (a, b)}

    def _ask(
        self, rows: Windows, matcher: AlignmentMatcher, query: Query, part: F32, is_known: bool
    ) -> None:
        try:
            weighed = matcher.weigh(part, RATE_HZ)
        except PerceptionError:
            return
        if weighed is None:
            return
        result, measures = weighed
        asked = replace(result, accepted=True)
        is_right = is_known and self.places.judge(query, asked, ConditionScore())
        group = self.groups.get(query.track.split(", ")[0])
        rows.measures.append(measures)
        rows.frames.append(result.votes)
        rows.is_right.append(bool(is_right))
        rows.is_known.append(is_known)
        rows.is_kin.append(group is not None and self.groups.get(result.track) == group)
        rows.condition.append(query.condition)
        rows.track.append(query.track)
