"""Tracks: one TOML file each, with timed rules from passages to skills.

`[[section]] start_s, end_s, skill`: the first rule that contains the position wins; where none
does, `default_skill` does.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.errors import CatalogError
from downbeat.runtime.errors import one_of

BUNDLED_TRACKS = Path(__file__).with_name("tracks")

_TRACK_KEYS: dict[str, type | tuple[type, ...]] = {
    "name": str,
    "title": str,
    "audio": str,
    "composition": str,
    "duration_s": (int, float),
    "tempo_bpm": (int, float),
    "first_beat_s": (int, float),
    "beats_per_bar": int,
    "beat_times_s": list,
    "default_skill": str,
    "section": list,
}
_SECTION_KEYS: dict[str, type | tuple[type, ...]] = {
    "name": str,
    "start_s": (int, float),
    "end_s": (int, float),
    "skill": str,
}


@dataclass(frozen=True, slots=True)
class Rule:
    """One timed rule: `skill` in [start_s, end_s) of the track."""

    start_s: float
    end_s: float
    skill: str
    name: str = ""


@dataclass(frozen=True)
class Track:
    """One track of the catalogue.

    Attributes:
        name: Unique name, as in the index.
        default_skill: Where no rule applies.
        grid: Beats.
        rules: Timed rules in file order.
        title: For people.
        audio: Audio file, None for a composition.
        composition: Name of a bundled piece, empty for an audio file.
        duration_s: Length [s], inf if the file does not say.
    """

    name: str
    default_skill: str
    grid: BeatGrid
    rules: tuple[Rule, ...] = ()
    title: str = ""
    audio: Path | None = None
    composition: str = ""
    duration_s: float = float("inf")
    where: str = field(default="", compare=False)

    def skill_at(self, tau_s: float) -> str:
        """Return the skill at a position: first matching rule, else the default."""
        for rule in self.rules:
            if rule.start_s <= tau_s < rule.end_s:
                return rule.skill
        return self.default_skill

    def next_change_s(self, tau_s: float) -> float | None:
        """Return the next position after `tau_s` at which the skill changes, None if never."""
        skill = self.skill_at(tau_s)
        edges = sorted({edge for rule in self.rules for edge in (rule.start_s, rule.end_s)})
        for edge in edges:
            if tau_s < edge < self.duration_s and self.skill_at(edge) != skill:
                return edge
        return None

    def sections(self, start_s: float, end_s: float) -> list[tuple[float, float, str]]:
        """Return gap-free (start, end, skill) of a passage [s], neighbours merged."""
        rows: list[tuple[float, float, str]] = []
        at = start_s
        while at < end_s:
            change = self.next_change_s(at)
            stop = end_s if change is None else min(change, end_s)
            rows.append((at, stop, self.skill_at(at)))
            at = stop
        return rows


def _check_keys(data: Mapping[str, Any], known: Mapping[str, Any], where: str) -> None:
    for key, value in data.items():
        if key not in known:
            raise CatalogError(
                f"Key '{key}' is unknown; known are {one_of(known)} ({where}:{key})."
            )
        kinds = known[key]
        if isinstance(value, bool) or not isinstance(value, kinds):
            names = kinds if isinstance(kinds, tuple) else (kinds,)
            wanted = " or ".join(kind.__name__ for kind in names)
            raise CatalogError(f"'{key}' is {value!r} but must be {wanted} ({where}:{key}).")


def parse_track(data: Mapping[str, Any], where: str, folder: Path) -> Track:
    """Validate a track's table.

    Raises:
        CatalogError: Anything wrong, with file and key.
    """
    _check_keys(data, _TRACK_KEYS, where)
    for key in ("name", "default_skill"):
        if key not in data:
            raise CatalogError(f"'{key}' is missing; a track needs it ({where}:{key}).")
    if ("audio" in data) == ("composition" in data):
        raise CatalogError(f"A track needs either 'audio' or 'composition' ({where}:audio).")
    audio = (folder / data["audio"]) if "audio" in data else None
    if audio is not None and not audio.is_file():
        raise CatalogError(f"Audio file {audio} does not exist ({where}:audio).")
    duration_s = float(data.get("duration_s", float("inf")))
    if not duration_s > 0.0:
        raise CatalogError(f"'duration_s' is {duration_s}, valid is > 0 ({where}:duration_s).")
    try:
        grid = BeatGrid(
            float(data.get("tempo_bpm", 120.0)),
            float(data.get("first_beat_s", 0.0)),
            int(data.get("beats_per_bar", 4)),
            tuple(float(t) for t in data.get("beat_times_s", ())),
        )
    except (CatalogError, TypeError, ValueError) as error:
        raise CatalogError(f"{error} ({where}:tempo_bpm)") from error
    return Track(
        name=data["name"],
        default_skill=data["default_skill"],
        grid=grid,
        rules=_rules(data.get("section", ()), where),
        title=data.get("title", data["name"]),
        audio=audio,
        composition=data.get("composition", ""),
        duration_s=duration_s,
        where=where,
    )


def _rules(entries: Iterable[Any], where: str) -> tuple[Rule, ...]:
    rules: list[Rule] = []
    for number, entry in enumerate(entries):
        at = f"{where}:section[{number}]"
        if not isinstance(entry, Mapping):
            raise CatalogError(f"A section must be a table ({at}).")
        _check_keys(entry, _SECTION_KEYS, at)
        for key in ("start_s", "end_s", "skill"):
            if key not in entry:
                raise CatalogError(f"'{key}' is missing; a section needs it ({at}.{key}).")
        rule = Rule(
            float(entry["start_s"]), float(entry["end_s"]), entry["skill"], entry.get("name", "")
        )
        if not 0.0 <= rule.start_s < rule.end_s:
            raise CatalogError(
                f"A section from {rule.start_s} to {rule.end_s} s is empty or starts before 0; "
                f"start_s must be below end_s ({at}.end_s)."
            )
        for other in rules:
            if rule.start_s < other.end_s and other.start_s < rule.end_s:
                raise CatalogError(
                    f"Section {rule.start_s}..{rule.end_s} s overlaps {other.start_s}.."
                    f"{other.end_s} s; sections may touch but not overlap ({at}.start_s)."
                )
        rules.append(rule)
    return tuple(rules)


def load_track(path: Path) -> Track:
    """Read one track file.

    Raises:
        CatalogError: Missing, not TOML, or wrong in any way.
    """
    if not path.is_file():
        raise CatalogError(f"Track file {path} does not exist.")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise CatalogError(f"{path} is not valid TOML: {error}.") from error
    return parse_track(data, str(path), path.parent)


def load_tracks(
    folder: Path = BUNDLED_TRACKS, skills: Iterable[str] | None = None
) -> dict[str, Track]:
    """Read every track file of a folder, sorted by name.

    Args:
        folder: Holds NAME.toml files; omitted: the bundled tracks.
        skills: If given, every rule must name one of these.

    Raises:
        CatalogError: No folder, no track, a doubled name, an unknown skill, a wrong file.
    """
    files = sorted(folder.glob("*.toml")) if folder.is_dir() else []
    if not files:
        raise CatalogError(f"{folder} holds no track file (NAME.toml).")
    known = None if skills is None else set(skills)
    tracks: dict[str, Track] = {}
    for path in files:
        track = load_track(path)
        if track.name in tracks:
            raise CatalogError(f"Track name '{track.name}' is used twice ({path}:name).")
        if known is not None:
            _check_skills(track, known)
        tracks[track.name] = track
    return tracks


def unknown_skills(track: Track, known: Collection[str]) -> list[tuple[str, str]]:
    """Return (skill, file:key) of everything that a track asks for and that is not known."""
    asked = [(rule.skill, f"section[{n}].skill") for n, rule in enumerate(track.rules)]
    asked.append((track.default_skill, "default_skill"))
    return [(skill, f"{track.where}:{key}") for skill, key in asked if skill not in known]


def _check_skills(track: Track, known: set[str]) -> None:
    for skill, where in unknown_skills(track, known):
        raise CatalogError(f"Skill '{skill}' is unknown; skills are {one_of(known)} ({where}).")
