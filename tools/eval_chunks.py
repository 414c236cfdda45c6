"""`downbeat eval chunks`: one short window alone, in every condition, and what must be refused.

Table and conditions are those of the peers' comparison; nothing here helps the matcher: no tracker,
no memory, one window of 5 s or of its first 3 s.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.progress import track as progress

from downbeat.catalog.tracks import BUNDLED_TRACKS, Track, load_tracks
from downbeat.perception import features as ft
from downbeat.perception.features import F32
from downbeat.perception.matcher import AlignmentMatcher, MatchResult
from downbeat.perception.source import Recording
from downbeat.tools.chunks_folder import (
    RATE_HZ,
    at_rate,
    make_index,
    read_folder,
    read_groups,
    read_tracks,
)
from downbeat.tools.chunks_make import (
    CHUNK_S,
    Query,
    all_queries,
    clean_queries,
    degraded_queries,
    foreign_queries,
    recombined,
)
from downbeat.tools.chunks_paper import (
    PaperScore,
    paper_shifts,
    paper_tracks,
    policies_by_length,
    policies_by_rule,
)
from downbeat.tools.chunks_report import (
    KIN,
    MUSIC,
    NO_MUSIC,
    RECOMBINED,
    SHORT,
    SHORT_S,
    SILENT,
    ChunkReport,
    print_report,
)
from downbeat.tools.chunks_score import ConditionScore, FalseAccepts, Places
from downbeat.tools.chunks_stream import (
    StreamScore,
    clips,
    count_locks,
    foreign_stream,
    hear_clip,
)
from downbeat.tools.composer.store import composed_recording
from downbeat.tools.conditions import degradations
from downbeat.tools.errors import ToolError
from downbeat.tools.matcher_sounds import make_babble, synthetic_sounds
from downbeat.tools.passages import find_passages
from downbeat.tools.rundir import CACHE_DIR

COMPOSED = CACHE_DIR / "tracks"
PAPER_CONDITIONS = ("clean", "robot")


@dataclass(frozen=True)
class ChunkOptions:
    """What to evaluate.

    Attributes:
        tracks: Folder of recordings; None: the bundled pieces, with their own timed rules.
        speech: Folder of voices, for babble and as strangers.
        other: Folder of other sounds, strangers.
        groups: Tab-separated file (track, group): same composer or same sample bank.
        per_shift: Clean chunks per track and shift.
        per_condition: Chunks per track and condition.
        seed: Of all noise.
        only: Conditions; empty: all.
        is_paper: The paper's experiment instead: policies by section.
        clips: Clips of 10 s per track for the listener itself; 0: none.
        foreign_s: Foreign music, and as much speech and noise, for the listener [s].
    """

    tracks: Path | None = None
    speech: Path | None = None
    other: Path | None = None
    groups: Path | None = None
    per_shift: int = 6
    per_condition: int = 6
    seed: int = 7
    only: tuple[str, ...] = ()
    is_paper: bool = False
    clips: int = 0
    foreign_s: float = 0.0


class ChunkStudy:
    """One run."""

    def __init__(self, options: ChunkOptions) -> None:
        """Decode and index.

        Raises:
            ToolError: Fewer than two tracks, an unknown condition, a bad group file.
            PerceptionError: A folder without recordings.
        """
        self.options = options
        self.rules: dict[str, Track] = {}
        if options.tracks is None:
            self.rules = load_tracks(BUNDLED_TRACKS)
            pieces = {n: composed_recording(t.composition, COMPOSED) for n, t in self.rules.items()}
            self.recordings = {n: replace(at_rate(r), name=n) for n, r in pieces.items()}
        else:
            self.recordings = read_tracks(options.tracks)
        self.groups = read_groups(options.groups)
        self.voices = read_folder(options.speech)
        self.others = read_folder(options.other)
        babble = None
        if self.voices:
            babble = make_babble([v.samples for v in self.voices], 30.0, RATE_HZ)
        self.degradations = degradations(babble)
        names = [d.name for d in self.degradations]
        if unknown := [name for name in options.only if name not in names]:
            voices = "" if self.voices else " (babble and robot need voices: --speech)"
            raise ToolError(
                f"Condition {unknown[0]!r} does not exist; valid are {', '.join(names)}{voices}."
            )
        if options.only:
            self.degradations = [d for d in self.degradations if d.name in options.only]
        self.report = ChunkReport(catalogue=len(self.recordings))
        begin = time.process_time()
        self.index = make_index(self.recordings.values())
        self.index.shared = find_passages(self.index)
        self.report.index_s = time.process_time() - begin
        self.report.index_bytes = sum(fine.nbytes for fine in self.index.fine)
        self.report.minutes = sum(r.duration_s for r in self.recordings.values()) / 60.0
        self.places = Places(
            {
                name: ft.to_matcher_rate(recording.samples, RATE_HZ)
                for name, recording in self.recordings.items()
            }
        )

    def run(self, is_quiet: bool) -> ChunkReport:
        """Ask everything."""
        whole = AlignmentMatcher(self.index)
        if self.options.is_paper:
            self._paper(is_quiet)
            return self.report
        self._streams(whole, is_quiet)
        for name in progress(list(self.recordings), "known", disable=is_quiet, transient=True):
            for query in self._queries(self.recordings[name], self.degradations):
                self._known(whole, query)
        rest = progress(list(self.recordings), "unknown", disable=is_quiet, transient=True)
        for number, name in enumerate(rest):
            self._unknown(number, self.recordings[name])
        for query in foreign_queries([*self.voices, *self.others], self.options.per_shift):
            self._refuse([NO_MUSIC], whole, query)
        return self.report

    def _queries(self, recording: Recording, wanted: Iterable[Any]) -> Iterable[Query]:
        for degradation in wanted:
            if degradation.name == "clean":
                yield from clean_queries(recording, self.options.per_shift)
            else:
                count, seed = self.options.per_condition, self.options.seed
                yield from degraded_queries(recording, degradation, count, seed)

    def _ask(self, matcher: AlignmentMatcher, samples: F32, is_timed: bool = False) -> MatchResult:
        begin = time.process_time()
        result = matcher.query(samples, RATE_HZ)
        if is_timed:
            self.report.query_ms.append((time.process_time() - begin) * 1e3)
        return result

    def _known(self, matcher: AlignmentMatcher, query: Query) -> None:
        if query.is_silent:
            self._refuse([SILENT], matcher, query)
            return
        conditions = self.report.conditions
        result = self._ask(matcher, query.samples, is_timed=True)
        self.places.judge(query, result, conditions.setdefault(query.condition, ConditionScore()))
        name = query.condition + SHORT
        result = self._ask(matcher, query.samples[: round(SHORT_S * RATE_HZ)])
        self.places.judge(query, result, conditions.setdefault(name, ConditionScore()))

    def _unknown(self, number: int, recording: Recording) -> None:
        """Hear a track that the catalogue lacks."""
        rest = [i for i in range(len(self.index.names)) if i != number]
        matcher = AlignmentMatcher(self.index.subset(rest))
        group = self.groups.get(recording.name)
        has_kin = group is not None and any(
            self.groups.get(self.index.names[i]) == group for i in rest
        )
        negative = [d for d in self.degradations if d.is_negative_too]
        for query in self._queries(recording, negative):
            self._refuse([MUSIC, KIN] if has_kin else [MUSIC], matcher, query)
        for music in recombined(recording, self.options.seed):
            for query in clean_queries(music, self.options.per_shift):
                self._refuse([RECOMBINED], matcher, query)

    def _paper(self, is_quiet: bool) -> None:
        """Run the paper's experiment: its tracks alone are the catalogue."""
        if self.rules:
            names, policy = list(self.recordings), policies_by_rule(self.rules)
        else:
            names = paper_tracks(self.recordings)
            policy = policies_by_length(names)
        matcher = AlignmentMatcher(self.index.subset([self.index.names.index(n) for n in names]))
        wanted = [d for d in self.degradations if d.name in PAPER_CONDITIONS]
        shifts_s = paper_shifts([self.recordings[name] for name in names])
        self.report.paper_shifts = len(shifts_s)
        for name in progress(names, "paper", disable=is_quiet, transient=True):
            for degradation in wanted:
                score = self.report.paper.setdefault(degradation.name, PaperScore())
                seed = self.options.seed
                for query in all_queries(self.recordings[name], degradation, seed, shifts_s):
                    is_timed = degradation.name == "clean"
                    result = self._ask(matcher, query.samples, is_timed)
                    score.add(query, result, policy, self.places.is_same_sound)

    def _streams(self, matcher: AlignmentMatcher, is_quiet: bool) -> None:
        """Let the listener hear clips, and what it must not lock on."""
        options, report = self.options, self.report
        wanted = [d for d in self.degradations if d.name in PAPER_CONDITIONS]
        names = list(self.recordings) if options.clips else []
        for name in progress(names, "clips", disable=is_quiet, transient=True):
            for degradation in wanted:
                score = report.streams.setdefault(degradation.name, StreamScore())
                made = clips(self.recordings[name], degradation, options.clips, options.seed)
                for start_s, clip in made:
                    hear_clip(matcher, start_s, clip, self.places.judge, score, report.cost)
        if not options.foreign_s:
            return
        share_s = options.foreign_s / len(self.recordings)
        turns = enumerate(self.recordings.items())
        locks: list[str] = []
        for number, (name, recording) in turns:
            rest = [i for i in range(len(self.index.names)) if i != number]
            sound = foreign_stream([recording], share_s, options.seed + number)
            stream = Recording(name, sound.samples, sound.sample_rate_hz)
            locks += count_locks(AlignmentMatcher(self.index.subset(rest)), stream, report.cost)
        report.false_locks[MUSIC] = (options.foreign_s, locks)
        sounds = [*self.voices, *self.others, *synthetic_sounds(10.0)]
        stream = foreign_stream(sounds, options.foreign_s, options.seed)
        locks = count_locks(matcher, stream, report.cost)
        report.false_locks[NO_MUSIC] = (options.foreign_s, locks)

    def _refuse(self, classes: Sequence[str], matcher: AlignmentMatcher, query: Query) -> None:
        for suffix, seconds in (("", CHUNK_S), (SHORT, SHORT_S)):
            result = self._ask(matcher, query.samples[: round(seconds * RATE_HZ)])
            is_same = result.accepted and self.places.is_same_sound(query, result)
            group = self.groups.get(query.track.split(", ")[0])  # "NAME, shuffled"
            is_kin = group is not None and self.groups.get(result.track) == group
            for name in classes:
                part = self.report.refused.setdefault(name + suffix, FalseAccepts())
                part.add(query, result, is_same, is_kin)


def eval_chunks(options: ChunkOptions, as_json: bool) -> int:
    """Run the study and print it; 0."""
    report = ChunkStudy(options).run(is_quiet=as_json)
    if as_json:
        print(json.dumps(report.as_json()))
    else:
        print_report(report)
    return 0
