"""`downbeat demo`: the bundled mashup through the whole process set."""

from __future__ import annotations

import json
from collections.abc import Container, Mapping
from pathlib import Path

from downbeat.catalog.setlist import SetEntry, SetList
from downbeat.catalog.tracks import BUNDLED_TRACKS, Track, load_tracks
from downbeat.perception.source import Recording
from downbeat.policies.manifest import load_skills
from downbeat.tools.commands.show import Demo
from downbeat.tools.composer.store import composed_recording
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_mashup import play, say, write_show
from downbeat.tools.finish import finish_run
from downbeat.tools.mashup import build_mashup
from downbeat.tools.recordings import INDEX_NAME, Library, build_index, write_track
from downbeat.tools.rundir import CACHE_DIR, new_run_dir

FAVOUR_S = 2.0
"""[s] off the middle that footwork in a passage is worth."""
ORDER = ("neon_parade", "salsa_del_puerto", "midnight_bones", "tide_runner")


def run_demo(args: Demo) -> int:
    """Build the show, play it, report; 0 if the robot stayed up and followed every section."""
    if args.scene == "onstage":
        return run_onstage(args)
    tracks = load_tracks(BUNDLED_TRACKS, load_skills())
    longest = min(track.duration_s for track in tracks.values())
    if not 10.0 <= args.section_seconds <= longest - 5.0:
        raise ToolError(
            f"--section-seconds {args.section_seconds} does not fit the bundled tracks; "
            f"valid are 10 to {longest - 5.0:.0f}."
        )
    run_dir = new_run_dir(args.runs)
    library = bundled_library(tracks, run_dir / "catalog")
    footwork = {n for n, m in load_skills().items() if m.kind == "stepping"}
    set_list = demo_set_list(tracks, args.section_seconds, footwork)
    mashup = build_mashup(set_list, tracks, library.recordings, args.announced)
    mashup.truth["seed"] = args.seed
    imported = "" if args.imported is None else str(args.imported.resolve())
    show = write_show(
        run_dir, mashup, library, args.seed, imported=imported, fallback=args.fallback
    )
    play(show, run_dir, mashup, not args.lockstep, args.url)
    metrics = finish_run(run_dir, video=args.video, quiet=args.json)
    if args.json:
        print(json.dumps(metrics))
    return 0 if metrics["good"] else 1


def run_onstage(args: Demo) -> int:
    """Play the stage scene; 0 if every line did what it was to do."""
    from downbeat.tools.onstage import build_scene, print_scene, speech_toml

    tracks = load_tracks(BUNDLED_TRACKS, load_skills())
    run_dir = new_run_dir(args.runs)
    library = bundled_library(tracks, run_dir / "catalog")
    scene = build_scene(library.recordings)
    scene.truth["seed"] = args.seed
    show = write_show(run_dir, scene, library, args.seed, speech=speech_toml(run_dir))
    play(show, run_dir, scene, not args.lockstep, args.url)
    metrics = finish_run(run_dir, video=args.video, quiet=args.json)
    speech = metrics["speech"]
    good = metrics["falls"] == 0 and all(row["good"] for row in speech["utterances"])
    if args.json:
        print(json.dumps(metrics))
    else:
        print_scene(metrics)
    return 0 if good and speech["resumed"] >= len(speech["utterances"]) else 1


def bundled_library(tracks: Mapping[str, Track], out: Path) -> Library:
    """Compose what is missing, and index the single tracks."""
    out.mkdir(parents=True, exist_ok=True)
    recordings: dict[str, Recording] = {}
    for name, track in tracks.items():
        sound = composed_recording(track.composition, CACHE_DIR / "tracks")
        recordings[name] = Recording(name, sound.samples, sound.sample_rate_hz)
        write_track(out / f"{name}.toml", track)
    build_index(recordings, out / INDEX_NAME)
    say(f"catalogue: {', '.join(tracks)}")
    return Library(dict(tracks), recordings, out)


def demo_set_list(
    tracks: Mapping[str, Track], section_s: float, favoured: Container[str] = ()
) -> SetList:
    """One passage a track, from a downbeat, with a rule change near its middle.

    Among passages that are about as good, one with a favoured skill is taken.
    """
    entries = []
    for name in ORDER:
        track = tracks[name]
        bar_s = track.grid.beats_per_bar * 60.0 / track.grid.tempo_bpm
        starts = [bar * bar_s for bar in range(1, int((track.duration_s - section_s) / bar_s))]
        best = min(starts, key=lambda start: _badness(track, start, section_s, favoured))
        entries.append(SetEntry(name, round(best, 6), section_s))
    return SetList(tuple(entries))


def _badness(track: Track, start_s: float, section_s: float, favoured: Container[str]) -> float:
    spans = track.sections(start_s, start_s + section_s)
    if len(spans) < 2:
        return 2.0 * section_s
    off_centre_s = abs(spans[0][1] - start_s - 0.5 * section_s)
    bonus_s = FAVOUR_S if any(skill in favoured for _, _, skill in spans) else 0.0
    # Rounded: passages that are equally good must not be told apart by the last bit.
    return round(off_centre_s - bonus_s, 3) + 10.0 * abs(len(spans) - 2)
