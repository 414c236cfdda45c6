"""`downbeat eval beat`: two minutes of one dance at a tempo; how far is it off the beat?"""

from __future__ import annotations

import json

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.setlist import SetEntry, SetList
from downbeat.catalog.tracks import Track
from downbeat.perception.source import Recording
from downbeat.policies.manifest import load_skills
from downbeat.runtime.errors import one_of
from downbeat.tools.commands.evaluate import Beat
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_mashup import play, say, write_show
from downbeat.tools.finish import finish_run
from downbeat.tools.mashup import build_mashup
from downbeat.tools.recordings import INDEX_NAME, Library, build_index, write_track
from downbeat.tools.rundir import new_run_dir
from downbeat.tools.tunes.pieces import PIECES, Piece
from downbeat.tools.tunes.synth import RATE

LIMIT_MS = 20.0
EXTRA_S = 6.0


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
    """Dance one tempo: a bundled piece, composed anew for it and long enough."""
    run_dir = new_run_dir(args.runs)
    piece = _long_piece(bpm, args.seconds + EXTRA_S)
    samples = piece.compose(piece)
    duration_s = len(samples) / RATE
    track = Track(
        piece.name,
        args.skill,
        BeatGrid(bpm),
        title=piece.title,
        composition=piece.name,
        duration_s=duration_s,
    )
    recordings = {piece.name: Recording(piece.name, samples, RATE)}
    catalog = run_dir / "catalog"
    catalog.mkdir()
    write_track(catalog / f"{piece.name}.toml", track)
    build_index(recordings, catalog / INDEX_NAME)
    library = Library({piece.name: track}, recordings, catalog)
    set_list = SetList((SetEntry(piece.name, 0.0, args.seconds + EXTRA_S),))
    mashup = build_mashup(set_list, library.tracks, recordings, announced=False)
    mashup.truth["seed"] = args.seed
    say(f"{bpm:g} BPM: {piece.title}, {duration_s:.0f} s")
    play(write_show(run_dir, mashup, library, args.seed), run_dir, mashup, False, "")
    metrics = finish_run(run_dir, video=False, quiet=True)
    error = metrics["beat_phase_error_ms"]
    return {"bpm": bpm, "seconds": args.seconds, "falls": metrics["falls"], **error}


def _long_piece(bpm: float, seconds: float) -> Piece:
    """Return the piece whose own tempo is nearest, at `bpm`, with its form repeated."""
    nearest = min(PIECES.values(), key=lambda piece: abs(piece.tempo_bpm - bpm))
    bars = seconds * bpm / 60.0 / nearest.beats_per_bar
    sections = nearest.sections
    while sum(count for _, count in sections) < bars:
        sections = sections + nearest.sections
    return Piece(nearest.name, nearest.title, bpm, nearest.beats_per_bar, sections, nearest.compose)
