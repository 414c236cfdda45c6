"""`downbeat rehearse`: every change that a show can ask for, planned and simulated before it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from downbeat.catalog.setlist import SetList, load_setlist
from downbeat.catalog.tracks import Track
from downbeat.control.atlas import Atlas
from downbeat.control.modes import BY_NAME
from downbeat.control.phase import PhaseFollower, PhaseLine
from downbeat.control.planner import Plan, direct_plan
from downbeat.control.prover import ProofConfig
from downbeat.control.transitions import Goal, beat_s
from downbeat.perception.grounding import NOT_BY_VOICE, STAND
from downbeat.perception.speech_config import SpeechConfig
from downbeat.perception.timeline import Span, Timeline
from downbeat.policies.manifest import SkillManifest
from downbeat.sim.batch.cells import Change, simulate
from downbeat.sim.batch.native import NativeEngine
from downbeat.sim.batch.outcome import Outcome, join_outcomes
from downbeat.sim.batch.perturb import BLOCK, draw_block, load_profile
from downbeat.sim.batch.states import visit
from downbeat.tools.console import say
from downbeat.tools.errors import ToolError
from downbeat.tools.rehearse_files import ShowFiles
from downbeat.tools.rehearse_rows import AMBER, GREEN, RED, Row, print_rows, waits
from downbeat.tools.show import (
    Show,
    load_show,
    show_atlas,
    show_skills,
    show_speech,
    show_tracks,
)
from downbeat.tools.speech_parts import allowed_skills

BASE_UTIME = 1_000_000_000
LOOK_AHEAD_US = 2_000_000
SEED = 7_000
"""Robots of a rehearsal are not those of the sweep."""
ALTERNATIVE_BEATS = 8


def run_rehearse(path: Path, rollouts: int, as_json: bool) -> int:
    """Rehearse a show; 0 if every change is proven, straight or through stand, 1 if one is not.

    Nothing is simulated where the show names what is not there: each such fault is said, and 2
    returned.

    Raises:
        ToolError: There is no atlas.
        DownbeatError: show.toml itself is wrong.
    """
    show = load_show(path)
    if faults := ShowFiles(show, path).faults():
        for sentence in faults:
            say(f"downbeat: {sentence}")
        return 2
    speech = show_speech(show)
    atlas = show_atlas(show)
    if atlas is None:
        raise ToolError(
            f"{path} is played without proofs (transitions, atlas), so there is nothing to "
            "rehearse; make an atlas with `downbeat sweep`."
        )
    rehearsals = Rehearsals(show, atlas, rollouts)
    rows = list(rehearsals.rows())
    if speech is not None:
        rows += rehearsals.spoken_rows(speech)
    if as_json:
        print(json.dumps([asdict(row) for row in rows]))
    else:
        print_rows(rows)
    return 0 if all(row.state != RED for row in rows) else 1


def spans_of(set_list: SetList, tracks: Mapping[str, Track]) -> list[Span]:
    """Return the stretches of one skill that a set list asks for."""
    spans: list[Span] = []
    for entry, start_s in zip(set_list.entries, set_list.starts_s(), strict=True):
        zero = BASE_UTIME + round((start_s - entry.from_s) * 1e6)
        passage = tracks[entry.track].sections(entry.from_s, entry.from_s + entry.seconds)
        for begin_s, _, skill in passage:
            start = zero + round(begin_s * 1e6)
            if not spans or spans[-1].skill != skill:
                spans.append(Span(entry.track, skill, start, zero))
    return spans


class Rehearsals:
    """Plans and simulates the changes of a show."""

    def __init__(self, show: Show, atlas: Atlas, rollouts: int) -> None:
        self._show, self._atlas = show, atlas
        self._skills = show_skills(show)
        self._tracks = show_tracks(show)
        self._blocks = max(1, -(-rollouts // BLOCK))
        self._engine = NativeEngine(self._skills)
        self._proof = ProofConfig(use_checker=show.config.checker)
        self._limit = self._proof.checked if show.config.checker else self._proof.unchecked

    def rows(self) -> Iterator[Row]:
        """Yield the changes in the order of the show."""
        set_list = self._set_list()
        if set_list is None:
            yield from self._surprises()
            return
        spans = spans_of(set_list, self._tracks)
        timeline = Timeline(self._tracks, set_list)
        for before, after in zip(spans, spans[1:]):
            yield self._announced(timeline, before, after)

    def _set_list(self) -> SetList | None:
        name = self._show.config.set_list
        return load_setlist(self._show.path(name), self._tracks) if name else None

    # ------------------------------------------------------------------ announced

    def _announced(self, timeline: Timeline, before: Span, after: Span) -> Row:
        a, b = self._skills[before.skill], self._skills[after.skill]
        onset = after.start_utime
        now = onset - LOOK_AHEAD_US
        goal = Goal(b, _line(timeline, after, b, onset), onset)
        line = _line(timeline, before, a, onset)
        follower = PhaseFollower(line, now, a.duration_s, beat_s(a), loop=a.loop)
        show_s = (onset - BASE_UTIME) * 1e-6
        plan = direct_plan(self._atlas, a, follower, goal, now, self._limit, now)
        if plan is None:
            advice = self._advice(a, follower, goal, now)
            return self._through_stand(a, b, show_s, advice)
        exit_s = line.at(plan.onset_utime) % a.duration_s
        entry_s = goal.line.at(plan.onset_utime) + plan.hop.shift_s
        outcome = self._simulate(a, b, plan, exit_s, entry_s)
        state = GREEN
        advice = ""
        if outcome.num_fallen > max(1, 0.02 * outcome.count):
            state, advice = RED, "it falls from this very phase, whatever the atlas says"
        name = f"{plan.mode}, {(plan.onset_utime - onset) * 1e-3:+.0f} ms"
        fallen = outcome.num_fallen
        return Row(show_s, a.name, b.name, state, name, plan.bound, outcome.count, fallen, advice)

    def _simulate(
        self, a: SkillManifest, b: SkillManifest, plan: Plan, exit_s: float, entry_s: float
    ) -> Outcome:
        profile = load_profile()
        parts = []
        for block in range(self._blocks):
            draws = draw_block(profile, SEED, block)
            visits = visit(self._engine, a, draws, (SEED, block))
            slot = self._atlas.exits(a).at(exit_s % a.duration_s)
            robots = np.flatnonzero(visits.valid[slot])
            change = Change(
                robots,
                np.full(len(robots), slot),
                np.zeros(len(robots), np.int64),
                np.full(len(robots), entry_s % b.duration_s),
            )
            mode = BY_NAME[plan.mode]
            parts.append(
                simulate(self._engine, visits, b, a, mode, change, draws, (SEED, block, 1))
            )
        return join_outcomes(parts)

    def _advice(self, a: SkillManifest, follower: PhaseFollower, goal: Goal, now: int) -> str:
        """Return why there is no direct plan, and the nearest one."""
        if (a.name, goal.skill.name) not in self._atlas.pairs:
            return "never swept (downbeat sweep)"
        beat_us = round((beat_s(goal.skill) or 0.5) / max(goal.line.rate, 1e-3) * 1e6)
        for step in range(1, ALTERNATIVE_BEATS + 1):
            for shift in (step * beat_us, -step * beat_us):
                moved = Goal(goal.skill, goal.line, goal.onset_utime + shift)
                plan = direct_plan(self._atlas, a, follower, moved, now, self._limit, now)
                if plan is not None:
                    when = "later" if shift > 0 else "earlier"
                    beats = "beat" if step == 1 else "beats"
                    return f"no proven slot here; {plan.mode} is, {step} {beats} {when}"
        return "no proven slot within two bars"

    def _through_stand(
        self, a: SkillManifest, b: SkillManifest, show_s: float | None, advice: str
    ) -> Row:
        """Return the row of a change that has no direct plan."""
        bound = sum(self._best_bound(*pair) for pair in ((a.name, "stand"), ("stand", b.name)))
        proven = max(self._best_bound(a.name, "stand"), self._best_bound("stand", b.name))
        state = AMBER if proven <= self._proof.checked else RED
        if state == RED:
            advice = f"{advice}; not through stand either"
        return Row(show_s, a.name, b.name, state, "via stand", min(bound, 1.0), 0, 0, advice)

    def _best_bound(self, source: str, target: str) -> float:
        if source == target:
            return 0.0
        cells = [c for c in self._atlas.cells.values() if (c.source, c.target) == (source, target)]
        return min((float(cell.bound.min()) for cell in cells), default=1.0)

    # ------------------------------------------------------------------ surprises

    def _surprises(self) -> Iterator[Row]:
        """Without a set list any skill of any track may follow any other, at any time."""
        names = sorted({rule for track in self._tracks.values() for rule in skills_in(track)})
        for a in names:
            for b in names:
                if a != b:
                    yield self._surprise(self._skills[a], self._skills[b])

    def spoken_rows(self, speech: SpeechConfig) -> list[Row]:
        """Return the changes that speech may ask for besides, at any time.

        Whatever dances, speech may ask for a skill or a stop, or the robot answers with its
        gesture; afterwards the music's skill, or an interrupted one, goes on.
        """
        set_list = self._set_list()
        spoken = set(allowed_skills(speech, self._skills)) - NOT_BY_VOICE
        spoken |= {speech.voice.gesture} - {""}
        if set_list is None:
            danced = {skill for track in self._tracks.values() for skill in skills_in(track)}
            rehearsed = {(a, b) for a in danced for b in danced}
        else:
            danced = {span.skill for span in spans_of(set_list, self._tracks)}
            rehearsed = set()
        return [
            replace(self._surprise(self._skills[a], self._skills[b]), asked_by="speech")
            for a, b in spoken_changes(spoken, danced)
            if (a, b) not in rehearsed
        ]

    def _surprise(self, a: SkillManifest, b: SkillManifest) -> Row:
        cells = [c for c in self._atlas.cells.values() if (c.source, c.target) == (a.name, b.name)]
        good = [c for c in cells if float(c.bound.min()) <= self._limit]
        if not good:
            why = "never swept (downbeat sweep)" if not cells else "no proven slot"
            return self._through_stand(a, b, None, why)
        share = {c.mode: float((c.bound <= self._limit).any(axis=1).mean()) for c in good}
        best = max(good, key=lambda c: share[c.mode])
        wait_s = self._longest_wait_s(a, best.bound)
        name = f"{best.mode}, {share[best.mode]:.0%} of the slots"
        bound = float(best.bound.min())
        return Row(
            None, a.name, b.name, GREEN, name, bound, best.count, best.fallen, waits(wait_s),
            wait_s=round(wait_s, 3),
        )  # fmt: skip

    def _longest_wait_s(self, a: SkillManifest, bound: np.ndarray) -> float:
        """Return the longest way from an unproven exit slot to a proven one [s]."""
        proven = (bound <= self._limit).any(axis=1)
        longest = run = 0
        for is_good in np.concatenate([proven, proven]):
            run = 0 if is_good else run + 1
            longest = max(longest, run)
        return min(longest, len(proven)) * self._atlas.exits(a).width_s


def spoken_changes(spoken: Iterable[str], danced: Iterable[str]) -> list[tuple[str, str]]:
    """Return the changes (before, after) into what is spoken for and out of it, by what follows.

    Args:
        spoken: Skills that speech may ask for, with the gesture of an answer.
        danced: Skills that the music may ask for.
    """
    spoken = {*spoken, STAND}
    names = sorted({*spoken, *danced})
    return [(a, b) for b in names for a in names if a != b and (a in spoken or b in spoken)]


def skills_in(track: Track) -> set[str]:
    """Return every skill that a track asks for."""
    return {skill for _, _, skill in track.sections(0.0, track.duration_s)}


def _line(timeline: Timeline, span: Span, skill: SkillManifest, utime: int) -> PhaseLine:
    fit = timeline.phase(span, skill, utime)
    return PhaseLine(fit.utime, fit.phase_s, fit.rate)
