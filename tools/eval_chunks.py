"""`downbeat eval chunks`: one short window alone, in every condition, and what must be refused.

Table and conditions are those of the peers' comparison; nothing here helps the matcher: no tracker,
no memory, one window of 5 s or of its first 3 s.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

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
from downbeat.tools.chunks_options import PAPER_CONDITIONS, ChunkOptions, check_groups
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
    LockCount,
    StreamScore,
    clips,
    count_locks,
    foreign_stream,
    hear_clip,
)
from downbeat.tools.composer.store import composed_recording
from downbeat.tools.console import say, tenths
from downbeat.tools.matcher_sounds import make_babble, synthetic_sounds
from downbeat.tools.passages import find_passages
from downbeat.tools.rundir import CACHE_DIR

COMPOSED = CACHE_DIR / "tracks"


class ChunkStudy:
    """One run."""

    def __init__(self, options: ChunkOptions) -> None:
        """Decode and index.

        Raises:
            ToolError: Fewer than two tracks, an unknown condition, a bad group file.
            PerceptionError: A folder without recordings.
        """
        options.check()
        self.options = options
        self.rules: dict[str, Track] = {}
        if options.tracks is None:
            self.rules = load_tracks(BUNDLED_TRACKS)
            pieces = {n: composed_recording(t.composition, COMPOSED) for n, t in self.rules.items()}
            self.recordings = {n: replace(at_rate(r), name=n) for n, r in pieces.items()}
        else:
            self.recordings = read_tracks(options.tracks)
        self.groups = read_groups(options.groups)
        if options.groups is not None:
            check_groups(self.groups, self.recordings, options.groups)
        self.voices = read_folder(options.speech)
        self.others = read_folder(options.other)
        babble = None
        if self.voices:
            babble = make_babble([v.samples for v in self.voices], 30.0, RATE_HZ)
        self.degradations = options.degradations(babble)
        self.report = ChunkReport(catalogue=len(self.recordings), has_groups=bool(self.groups))
        begin = time.process_time()
        self.index = make_index(tenths(list(self.recordings.values()), "indexed"))
        say("looking for passages that two of them share")
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

    def run(self) -> ChunkReport:
        """Ask everything."""
        whole = AlignmentMatcher(self.index)
        if self.options.is_paper:
            self._paper()
            return self.report
        self._streams(whole)
        for name in tenths(list(self.recordings), "asked for what is known"):
            for query in self._queries(self.recordings[name], self.degradations):
                self._known(whole, query)
        for number, name in enumerate(tenths(list(self.recordings), "asked for what is not")):
            self._unknown(number, self.recordings[name])
        sounds = [*self.voices, *self.others]
        for query in foreign_queries(sounds, self.options.per_shift):
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
            self._refuse([SILENT], matcher, query, self.groups.get(query.track))
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
            self._refuse([MUSIC, KIN] if has_kin else [MUSIC], matcher, query, group)
        for music in recombined(recording, self.options.seed):
            for query in clean_queries(music, self.options.per_shift):
                self._refuse([RECOMBINED], matcher, query, group)

    def _paper(self) -> None:
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
        for name in tenths(names, "paper"):
            for degradation in wanted:
                score = self.report.paper.setdefault(degradation.name, PaperScore())
                seed = self.options.seed
                for query in all_queries(self.recordings[name], degradation, seed, shifts_s):
                    if query.is_silent:
                        score.leave_out(query)
                        continue
                    is_timed = degradation.name == "clean"
                    result = self._ask(matcher, query.samples, is_timed)
                    score.add(query, result, policy, self.places.is_same_sound)

    def _streams(self, matcher: AlignmentMatcher) -> None:
        """Let the listener hear clips, and what it must not lock on."""
        options, report = self.options, self.report
        wanted = [d for d in self.degradations if d.name in PAPER_CONDITIONS]
        names = list(self.recordings) if options.clips else []
        for name in tenths(names, "clips heard"):
            for degradation in wanted:
                score = report.streams.setdefault(degradation.name, StreamScore())
                count, seed = options.clips, options.seed
                made = clips(self.recordings[name], degradation, count, seed, score)
                for start_s, clip in made:
                    hear_clip(matcher, start_s, clip, self.places.judge, score, report.cost)
        if not options.foreign_s:
            return
        share_s = options.foreign_s / len(self.recordings)
        is_same, cost = self.places.is_same_sound, report.cost
        music = report.false_locks[MUSIC] = LockCount()
        for number, name in enumerate(tenths(list(self.recordings), "foreign music heard")):
            rest = [i for i in range(len(self.index.names)) if i != number]
            seed = options.seed + number
            stream = foreign_stream([self.recordings[name]], share_s, seed)
            others = AlignmentMatcher(self.index.subset(rest))
            count_locks(others, stream, is_same, music, cost)
        say(f"hearing {options.foreign_s / 60.0:g} min of {NO_MUSIC}")
        sounds = [*self.voices, *self.others, *synthetic_sounds(10.0)]
        stream = foreign_stream(sounds, options.foreign_s, options.seed)
        noise = report.false_locks[NO_MUSIC] = LockCount()
        count_locks(matcher, stream, is_same, noise, cost)

    def _refuse(
        self,
        classes: Sequence[str],
        matcher: AlignmentMatcher,
        query: Query,
        group: str | None = None,
    ) -> None:
        for suffix, seconds in (("", CHUNK_S), (SHORT, SHORT_S)):
            result = self._ask(matcher, query.samples[: round(seconds * RATE_HZ)])
            is_same = result.accepted and self.places.is_same_sound(query, result)
            is_kin = group is not None and self.groups.get(result.track) == group
            for name in classes:
                part = self.report.refused.setdefault(name + suffix, FalseAccepts())
                part.add(query, result, is_same, is_kin)


def eval_chunks(options: ChunkOptions, as_json: bool) -> int:
    """Run the study and print it; 0."""
    report = ChunkStudy(options).run()
    if as_json:
        print(json.dumps(report.as_json()))
    else:
        print_report(report)
    return 0
