"""`downbeat eval beat`: two minutes of one dance at a tempo; how far is it off the beat?"""

from __future__ import annotations

import json

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.setlist import SetEntry, SetList
from downbeat.catalog.tracks import Track
from downbeat.policies.manifest import load_skills
from downbeat.runtime.errors import one_of
from downbeat.tools.commands.evaluate import Beat
from downbeat.tools.composer.store import COMPOSITIONS, composed_recording, form
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_mashup import play, say, write_show
from downbeat.tools.finish import finish_run
from downbeat.tools.mashup import build_mashup
from downbeat.tools.recordings import INDEX_NAME, Library, build_index, write_track
from downbeat.tools.rundir import CACHE_DIR, new_run_dir

LIMIT_MS = 20.0
LEAD_S = 6.0
"""Until the first lock and the settling of the phase; on top of what is asked for."""


def run_eval_beat(args: Beat) -> int:
    """Run each tempo; 0 if every p95 is within 20 ms and nobody fell."""
    skills = load_skills()
    dances = [n for n, m in skills.items() if m.bpm > 0]
    if args.skill not in dances:
        raise ToolError(f"--skill '{args.skill}' has no beat; dances are {one_of(dances)}.")
    rows = [_one(args, bpm) for bpm in args.bpm]
    if args.json:
        print(json.dumps(rows))
    else:
        for row in rows:
            print(
                f"{row['bpm']:g} BPM, {args.skill}, {row['seconds']:g} s: beat-phase error "
                f"p50 {row['p50']:.1f} p95 {row['p95']:.1f} max {row['max']:.1f} ms, "
                f"falls {row['falls']}"
            )
    return 0 if all(row["p95"] <= LIMIT_MS and row["falls"] == 0 for row in rows) else 1


def _one(args: Beat, bpm: float) -> dict[str, float]:
    """Dance one tempo: the piece of that tempo, from its beginning again and again."""
    piece = next((name for name in COMPOSITIONS if form(name).bpm == bpm), None)
    if piece is None:
        tempos = one_of(form(name).bpm for name in COMPOSITIONS)
        raise ToolError(f"There is no piece at {bpm:g} BPM; there are {tempos} (--bpm).")
    run_dir = new_run_dir(args.runs)
    sound = composed_recording(piece, CACHE_DIR / "tracks")
    track = Track(piece, args.skill, BeatGrid(bpm), composition=piece, duration_s=sound.duration_s)
    recordings = {piece: sound}
    catalog = run_dir / "catalog"
    catalog.mkdir()
    write_track(catalog / f"{piece}.toml", track)
    build_index(recordings, catalog / INDEX_NAME)
    library = Library({piece: track}, recordings, catalog)
    mashup = build_mashup(_rounds(piece, bpm, args.seconds), library.tracks, recordings, True)
    mashup.truth["seed"] = args.seed
    say(f"{bpm:g} BPM: {piece}, {mashup.truth['duration_s']:.0f} s")
    play(write_show(run_dir, mashup, library, args.seed), run_dir, mashup, False, "")
    metrics = finish_run(run_dir, video=False, quiet=True)
    error = metrics["beat_phase_error_ms"]
    return {"bpm": bpm, "seconds": args.seconds, "falls": metrics["falls"], **error}


def _rounds(piece: str, bpm: float, seconds: float) -> SetList:
    """Return whole rounds of a piece, cut on bars so that the beat goes on, then the rest."""
    round_s = form(piece).beats * 60.0 / bpm
    left_s = seconds + LEAD_S
    entries = []
    while left_s > 0.0:
        entries.append(SetEntry(piece, 0.0, min(round_s, left_s)))
        left_s -= round_s
    return SetList(tuple(entries))
