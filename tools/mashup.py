"""Mashups: passages of tracks cut together, with the truth about them for the evaluator."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
import soxr

from downbeat.catalog.setlist import SetEntry, SetList
from downbeat.catalog.tracks import Track
from downbeat.perception.features import F32
from downbeat.perception.source import Recording
from downbeat.tools.errors import ToolError

SAMPLE_RATE_HZ = 44_100
PASSAGE_TRIES = 100
GOOD_SPAN_SHARE = 0.4
"""A passage whose every span has this share of a section is taken at once."""
PAUSE_S, PAUSE_DBFS = 2.0, -45.0
FADE_S = 0.003
"""A cut is hard, but it does not click."""


@dataclass(frozen=True)
class Mashup:
    """A mashup and what is true of it.

    Attributes:
        samples: (n,) mono.
        set_list: Its passages.
        truth: Content of truth.json.
        left_out: Tracks without a long enough passage.
    """

    samples: F32
    set_list: SetList
    truth: dict[str, Any]
    left_out: tuple[str, ...] = ()

    def write(self, folder: Path) -> None:
        """Write mashup.wav, truth.json and, for an announced show, setlist.toml."""
        pcm = np.clip(self.samples, -1.0, 1.0)
        soundfile.write(folder / "mashup.wav", pcm, SAMPLE_RATE_HZ, subtype="PCM_16")
        text = json.dumps(self.truth, indent=1)
        (folder / "truth.json").write_text(text, encoding="utf-8")
        if self.truth["announced"]:
            (folder / "setlist.toml").write_text(self.set_list.to_toml(), encoding="utf-8")


def build_mashup(
    set_list: SetList,
    tracks: Mapping[str, Track],
    recordings: Mapping[str, Recording],
    announced: bool,
    left_out: Sequence[str] = (),
) -> Mashup:
    """Cut the passages of `set_list` together."""
    parts = [_passage(recordings[e.track], e) for e in set_list.entries]
    samples = np.concatenate(parts)
    truth = {
        "version": 1,
        "sample_rate_hz": SAMPLE_RATE_HZ,
        "duration_s": len(samples) / SAMPLE_RATE_HZ,
        "announced": announced,
        "segments": _segments(set_list),
        "sections": _sections(set_list, tracks, announced),
        "beat_grids": {e.track: _grid(tracks[e.track]) for e in set_list.entries},
    }
    return Mashup(samples, set_list, truth, tuple(left_out))


def _passage(recording: Recording, entry: SetEntry) -> F32:
    rate = recording.sample_rate_hz
    first = round(entry.from_s * rate)
    part = recording.samples[first : first + round(entry.seconds * rate)]
    if rate != SAMPLE_RATE_HZ:
        part = soxr.resample(part, rate, SAMPLE_RATE_HZ)
    count = round(entry.seconds * SAMPLE_RATE_HZ)
    part = np.pad(part, (0, max(0, count - len(part))))[:count].astype(np.float32)
    fade = np.linspace(0.0, 1.0, round(FADE_S * SAMPLE_RATE_HZ), dtype=np.float32)
    part[: len(fade)] *= fade
    part[-len(fade) :] *= fade[::-1]
    return part


def _segments(set_list: SetList) -> list[dict[str, Any]]:
    return [
        {
            "track": entry.track,
            "track_from_s": entry.from_s,
            "start_s": start,
            "end_s": start + entry.seconds,
        }
        for entry, start in zip(set_list.entries, set_list.starts_s())
    ]


def _sections(
    set_list: SetList, tracks: Mapping[str, Track], announced: bool
) -> list[dict[str, Any]]:
    """Return the sections with the kind of the boundary at their start; same skills merge."""
    rows: list[dict[str, Any]] = []
    for entry, start in zip(set_list.entries, set_list.starts_s()):
        passage = tracks[entry.track].sections(entry.from_s, entry.from_s + entry.seconds)
        for number, (begin_s, end_s, skill) in enumerate(passage):
            cut = "announced" if announced else "unannounced"
            boundary = "start" if not rows else cut if number == 0 else "announced"
            row = {
                "start_s": start + begin_s - entry.from_s,
                "end_s": start + end_s - entry.from_s,
                "skill": skill,
                "track": entry.track,
                "boundary": boundary,
            }
            if rows and rows[-1]["skill"] == skill:
                rows[-1]["end_s"] = row["end_s"]
            else:
                rows.append(row)
    return rows


def _grid(track: Track) -> dict[str, Any]:
    grid = track.grid
    if grid.beat_times_s:
        return {"beat_times_s": list(grid.beat_times_s)}
    return {"tempo_bpm": grid.tempo_bpm, "first_beat_s": grid.first_beat_s}


def longest_passage_s(recording: Recording) -> float:
    """Return the length of the longest passage without a pause of two seconds [s]."""
    block = round(PAUSE_S * recording.sample_rate_hz)
    count = len(recording.samples) // block
    blocks = recording.samples[: count * block].reshape(count, block)
    loud = np.sqrt((blocks.astype(np.float64) ** 2).mean(1)) > 10.0 ** (PAUSE_DBFS / 20.0)
    longest = run = 0
    for is_loud in loud:
        run = run + 1 if is_loud else 0
        longest = max(longest, run)
    return longest * PAUSE_S


def is_sounding(recording: Recording, from_s: float, seconds: float) -> bool:
    """Whether a passage has no pause of two seconds."""
    rate = recording.sample_rate_hz
    part = recording.samples[round(from_s * rate) : round((from_s + seconds) * rate)]
    cut = Recording(recording.name, part, rate)
    return longest_passage_s(cut) >= seconds - 2.0 * PAUSE_S


def seeded_set_list(
    tracks: Mapping[str, Track],
    recordings: Mapping[str, Recording],
    section_s: float,
    count: int,
    seed: int,
) -> tuple[SetList, tuple[str, ...]]:
    """Choose tracks and passages by seed; neighbours differ in track and in skill at the cut.

    Returns:
        The set list, and the names of tracks that have no passage long enough without a pause.

    Raises:
        ToolError: Fewer than two tracks are long enough.
    """
    rng = np.random.default_rng(seed)
    margin_s = 2.0 * PAUSE_S
    names = [n for n, r in recordings.items() if longest_passage_s(r) >= section_s + margin_s]
    left_out = tuple(n for n in tracks if n not in names)
    if len(names) < 2:
        raise ToolError(
            f"A mashup of {section_s} s sections needs two tracks that long; "
            f"there are {len(names)} (left out: {', '.join(left_out) or 'none'})."
        )
    entries: list[SetEntry] = []
    bag: list[str] = []
    while len(entries) < count:
        if not bag:
            bag = [str(n) for n in rng.permutation(names)]
        name = _next_name(bag, names, entries[-1] if entries else None, tracks)
        if name in bag:
            bag.remove(name)
        entries.append(_seeded_entry(tracks, recordings[name], section_s, entries, rng))
    return SetList(tuple(entries)), left_out


def _next_name(
    bag: Sequence[str], names: Sequence[str], last: SetEntry | None, tracks: Mapping[str, Track]
) -> str:
    """Return who may follow: best a track not played yet, of another skill; never the same track.

    If all other tracks have the skill of the last one, one of them has to do.
    """
    if last is None:
        return bag[0]
    others = [name for name in (*bag, *names) if name != last.track]
    skill = tracks[last.track].default_skill
    return next((name for name in others if tracks[name].default_skill != skill), others[0])


def _seeded_entry(
    tracks: Mapping[str, Track],
    recording: Recording,
    section_s: float,
    before: Sequence[SetEntry],
    rng: np.random.Generator,
) -> SetEntry:
    """Draw a passage: of some tries the one whose shortest span is longest.

    A section of two seconds is no dance; and the skill at a cut should differ from the one before.
    """
    name = recording.name
    room_s = recording.duration_s - section_s - 0.2
    running = ""
    if before:
        last = before[-1]
        running = tracks[last.track].skill_at(last.from_s + last.seconds - 1e-3)
    best_s, best_from_s = -1.0, 0.0
    for _ in range(PASSAGE_TRIES):
        from_s = round(float(rng.uniform(0.0, room_s)), 3)
        if not is_sounding(recording, from_s, section_s):
            continue
        spans = tracks[name].sections(from_s, from_s + section_s)
        shortest_s = min(end_s - start_s for start_s, end_s, _ in spans)
        if tracks[name].skill_at(from_s) == running:
            shortest_s -= section_s
        if shortest_s > best_s:
            best_s, best_from_s = shortest_s, from_s
        if best_s >= GOOD_SPAN_SHARE * section_s:
            break
    return SetEntry(name, best_from_s, section_s)
