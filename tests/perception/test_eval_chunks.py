"""The chunk study on synthetic music: its truth is known, so its counting can be checked."""

import json
import re

import numpy as np
import pytest
import soundfile
from scipy.signal import fftconvolve
from synthetic_music import RATE, make_music

from downbeat.perception import features as ft
from downbeat.perception.matcher import AlignmentMatcher, MatchResult
from downbeat.perception.source import Recording
from downbeat.tools import chunks_paper
from downbeat.tools.catalog_tools import build, match
from downbeat.tools.chunks_folder import make_index
from downbeat.tools.chunks_make import CHUNK_S, SHIFTS_S, Query, starts
from downbeat.tools.chunks_paper import CHUNKS, PaperScore, paper_shifts, policies_by_length
from downbeat.tools.chunks_report import KIN, LABELS, SHORT, ChunkReport, print_report
from downbeat.tools.chunks_score import ConditionScore, FalseAccepts, Places
from downbeat.tools.chunks_stream import (
    Cost,
    ForeignStream,
    LockCount,
    Part,
    StreamScore,
    clips,
    count_locks,
    foreign_stream,
)
from downbeat.tools.conditions import degradations
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_chunks import ChunkOptions, ChunkStudy, eval_chunks
from downbeat.tools.matcher_sounds import make_babble


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Three tracks of 24 s and a voice."""
    out = tmp_path_factory.mktemp("chunks")
    for name in ("music", "speech"):
        (out / name).mkdir()
    for seed in range(3):
        soundfile.write(out / "music" / f"piece{seed}.wav", make_music(seed, 24.0), RATE)
    voice = 0.1 * np.random.default_rng(1).standard_normal(8 * RATE)
    soundfile.write(out / "speech" / "voice.wav", voice, RATE)
    return out


@pytest.mark.parametrize(
    "name", [d.name for d in degradations(np.ones(10, np.float32)) if d.time_factor == 1.0]
)
def test_what_keeps_the_time_of_the_music_keeps_it_to_the_millisecond(name):
    """The pitch may be off by a piece of the overlap-add, and a room answers late."""
    music = make_music(5, 6.0)
    voice = np.random.default_rng(2).standard_normal(RATE).astype(np.float32)
    babble = make_babble([voice], 5.0, RATE)
    (condition,) = [d for d in degradations(babble) if d.name == name]
    heard = condition.apply(music, RATE, np.random.default_rng(3))
    assert heard.dtype == np.float32 and len(heard) == len(music)
    if name.startswith("pitch"):
        envelope = [
            np.abs(x[: len(x) // 500 * 500]).reshape(-1, 500).mean(1) for x in (music, heard)
        ]
        one, other = (e - e.mean() for e in envelope)
        lag = int(fftconvolve(other, one[::-1]).argmax()) - len(one) + 1
        assert abs(lag * 500 / RATE) <= 0.03
        return
    lag = int(fftconvolve(heard, music[::-1]).argmax()) - len(music) + 1
    assert abs(lag / RATE) <= (0.03 if name == "robot" else 0.002)


@pytest.mark.parametrize("percent", (-4, 4))
def test_time_factors_are_what_they_say(percent):
    music = make_music(5, 6.0)
    for condition in degradations(None):
        if condition.name in (f"tempo{percent:+d}%", f"speed{percent:+d}%"):
            heard = condition.apply(music, RATE, np.random.default_rng(0))
            assert len(heard) * condition.time_factor == pytest.approx(len(music), rel=1e-3)


def test_chunks_lie_inside_the_track_at_the_five_shifts():
    for shift_s in SHIFTS_S:
        found = starts(23.0, 100, shift_s)
        assert all(s >= 0.0 and s + CHUNK_S <= 23.0 and (s - shift_s) % 5.0 == 0.0 for s in found)
    assert len(starts(23.0, 100, 0.0)) == 4
    assert len(starts(600.0, 6, 0.5)) == 6


def test_every_clean_chunk_of_known_music_is_found_and_no_stranger(folder):
    only = ("clean", "white10", "robot")
    options = ChunkOptions(folder / "music", folder / "speech", None, None, 4, 1, only=only)
    report = ChunkStudy(options).run()
    contract = json.loads(json.dumps(report.as_json()))
    assert contract["chunks"]["total"] == contract["chunks"]["correct"] == 3 * 5 * 4
    assert contract["conditions"]["white10"]["accepted"] == 1.0
    assert contract["false_accepts"]["rate"] == 0.0
    assert 0.0 < contract["false_accepts"]["upper95"] < 0.03
    assert contract["false_accepts_short"]["rate"] < 0.02  # half of them are one generator's music
    assert contract["false_accepts"]["n"] == contract["false_accepts_short"]["n"] > 60
    assert contract["query_ms"]["p50"] <= contract["query_ms"]["p99"]


def test_a_wrong_place_is_wrong_and_a_verbatim_repeat_is_counted_apart():
    verse = make_music(8, 6.0)
    bridge = make_music(9, 6.0)
    places = Places({"song": ft.to_matcher_rate(np.concatenate([verse, bridge, verse]), RATE)})
    query = Query("clean", "song", 0.5, 0.0, verse, False)
    score = ConditionScore()
    assert places.judge(query, MatchResult("song", 0.55, accepted=True), score)
    assert places.judge(query, MatchResult("song", 12.5, accepted=True), score)
    assert not places.judge(query, MatchResult("song", 6.5, accepted=True), score)
    assert not places.judge(query, MatchResult("other", 0.5, accepted=True), score)
    assert (score.n, score.top1, score.right, score.elsewhere) == (4, 3, 2, 1)
    assert (score.accepted, score.wrong) == (2, 2)


def test_the_bound_on_false_accepts_is_that_of_the_binomial():
    part = FalseAccepts(n=300)
    assert part.upper95 == pytest.approx(1.0 - 0.05 ** (1 / 300))
    part.accepted = 300
    assert part.upper95 == 1.0


def test_policies_are_judged_by_section_and_chunks_over_a_boundary_apart():
    policy, score = policies_by_length(["a", "b"]), PaperScore()
    nothing = np.zeros(1, np.float32)

    def is_repeat(_query, result):
        return result.tau_s == 65.0

    def ask(at_s, found_s, accepted=True, track="a"):
        result = MatchResult(track, found_s, accepted=accepted)
        score.add(Query("clean", "a", at_s, 0.0, nothing, False), result, policy, is_repeat)

    ask(5.0, 5.0)
    ask(5.0, 25.0)  # another section
    ask(5.0, 5.0, accepted=False)
    ask(5.0, 5.0, track="b")
    assert (score.total, score.correct, score.repeats) == (4, 1, 0)
    ask(5.0, 65.0)  # the identical passage, elsewhere
    assert (score.total, score.correct, score.repeats) == (4, 1, 1)
    ask(17.0, 17.0)
    ask(17.0, 1.0)
    assert (score.straddling, score.by_start, score.by_end) == (2, 2, 1)


def test_an_unknown_condition_and_a_bad_group_file_are_named(folder, tmp_path):
    with pytest.raises(ToolError, match="'fog' does not exist; valid are clean"):
        ChunkStudy(ChunkOptions(folder / "music", only=("fog",)))
    with pytest.raises(ToolError, match=r"'robot' is made of voices; .*\(--speech FOLDER\)"):
        ChunkStudy(ChunkOptions(folder / "music", only=("robot",)))
    with pytest.raises(ToolError, match="made in clean and robot, and --only names white5"):
        ChunkStudy(ChunkOptions(folder / "music", only=("white5",), is_paper=True))
    with pytest.raises(ToolError, match="--per-shift is below 0"):
        ChunkStudy(ChunkOptions(folder / "music", per_shift=-1))
    groups = tmp_path / "groups.tsv"
    groups.write_text("a\tb\nc\n", encoding="utf-8")
    with pytest.raises(ToolError, match=r"groups.tsv:2 has 1 columns"):
        ChunkStudy(ChunkOptions(folder / "music", groups=groups))


def test_a_catalogue_names_recordings_that_are_the_same_and_answers_in_json(
    folder, tmp_path, capsys
):
    audio = tmp_path / "audio"
    audio.mkdir()
    for seed in range(2):
        soundfile.write(audio / f"piece{seed}.wav", make_music(seed, 24.0), RATE)
    copy = Recording("again", make_music(0, 24.0)[RATE:], RATE)
    soundfile.write(audio / "again.ogg", copy.samples, RATE)
    assert build(audio, tmp_path / "catalog", 0) == 0
    said = capsys.readouterr().out
    assert "'again' and 'piece0' hold the same recording" in said
    assert "'piece1'" not in said
    assert match(tmp_path / "catalog", audio / "piece1.wav", 6.0, 5.0, True, "alignment") == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["track"] == "piece1" and answer["accepted"] is True
    assert answer["tau_s"] == pytest.approx(6.0, abs=0.02)
    assert {"confidence", "votes", "rate"} <= set(answer)


def test_the_identical_recording_under_another_name_is_counted_apart():
    """Two tracks share 12 s bit for bit: where one is unknown, the other is no stranger there."""
    shared = make_music(20, 12.0)
    tracks = {
        "one": np.concatenate([make_music(21, 8.0), shared]),
        "two": np.concatenate([make_music(22, 6.0), shared]),
    }
    places = Places({name: ft.to_matcher_rate(x, RATE) for name, x in tracks.items()})
    counted = FalseAccepts()
    for start_s, found, tau_s, is_accepted in (
        (10.0, "two", 8.0, True),  # the same recording there
        (10.0, "two", 9.0, True),  # another place of it
        (2.0, "two", 2.0, True),  # other music
        (12.0, "two", 10.0, False),
    ):
        query = Query("clean", "one", start_s, 0.0, shared, False)
        result = MatchResult(found, tau_s, accepted=is_accepted)
        counted.add(query, result, places.is_same_sound(query, result))
    assert (counted.n, counted.accepted, counted.elsewhere) == (4, 2, 1)
    assert counted.shares()["rate"] == 0.5
    assert counted.shares()["elsewhere"] == ["clean: one at 10 s taken for two (0.00)"]


@pytest.mark.parametrize(("seconds", "shifts"), [(75.0, 20), (150.0, 5)])
def test_short_pieces_are_asked_at_more_shifts_until_there_are_as_many_chunks(seconds, shifts):
    pieces = [Recording(f"{k}", np.ones(round(seconds * 100), np.float32), 100) for k in range(4)]
    chosen = paper_shifts(pieces)
    assert len(chosen) == shifts and set(SHIFTS_S) <= set(chosen)
    assert sum(len(starts(p.duration_s, 10_000, s)) for p in pieces for s in chosen) >= CHUNKS


def test_what_cannot_be_read_or_indexed_is_named_and_left_out(folder, tmp_path, capsys):
    for file in (folder / "music").iterdir():
        (tmp_path / file.name).symlink_to(file)
    (tmp_path / "letter.wav").write_text("no sound")
    soundfile.write(tmp_path / "pause.wav", np.zeros(8 * RATE), RATE)
    soundfile.write(tmp_path / "jingle.wav", make_music(7, 2.0), RATE)
    study = ChunkStudy(ChunkOptions(tracks=tmp_path))
    assert sorted(study.recordings) == ["piece0", "piece1", "piece2"]
    said = capsys.readouterr().err.splitlines()
    for name in ("letter", "pause is silent", "jingle is shorter"):
        assert sum(name in line and line.startswith("left out") for line in said) == 1


def test_a_folder_with_one_useful_recording_is_refused_in_a_sentence(folder, tmp_path):
    soundfile.write(tmp_path / "pause.wav", np.zeros(8 * RATE), RATE)
    (tmp_path / "piece.wav").symlink_to(folder / "music" / "piece0.wav")
    with pytest.raises(ToolError, match="holds 1 recording that can be indexed; valid are two"):
        ChunkStudy(ChunkOptions(tracks=tmp_path))


def test_names_of_groups_that_match_no_recording_are_counted_or_refused(folder, tmp_path, capsys):
    groups = tmp_path / "groups.tsv"
    groups.write_text("piece0\tx\npiece1\tx\npeace2\ty\n", encoding="utf-8")
    study = ChunkStudy(ChunkOptions(folder / "music", groups=groups))
    assert study.groups["piece1"] == "x"
    said = capsys.readouterr().err
    assert "1 of 3 names match no recording: peace2" in said
    assert "1 of 3 recordings are in no group: piece2" in said
    groups.write_text("peace2\ty\n", encoding="utf-8")
    with pytest.raises(ToolError, match="names none of the 3 recordings .*'peace2'.*'piece0'"):
        ChunkStudy(ChunkOptions(folder / "music", groups=groups))


@pytest.fixture
def short_experiment(monkeypatch, tmp_path):
    """A folder of two pieces that end and begin in silence; the experiment needs no more."""
    for name, value in (("TRACKS", 2), ("CHUNKS", 24)):
        monkeypatch.setattr(chunks_paper, name, value)
    pause = np.zeros(round(11.2 * RATE), np.float32)
    soundfile.write(tmp_path / "ends.wav", np.concatenate([make_music(3, 24.0), pause]), RATE)
    soundfile.write(tmp_path / "begins.wav", np.concatenate([pause, make_music(4, 24.0)]), RATE)
    return tmp_path


def test_the_papers_experiment_asks_nothing_of_silence_and_says_so(short_experiment, capsys):
    options = ChunkOptions(short_experiment, is_paper=True)
    report = ChunkStudy(options).run()
    score = report.paper["clean"]
    assert score.total - score.correct <= 1  # one holds 0.3 s of sound, and is asked
    assert all("begins at 6.5 s" in wrong for wrong in score.wrong)
    grid = [s for shift_s in SHIFTS_S for s in starts(35.2, 100, shift_s)]
    silent = sum(s + CHUNK_S <= 11.2 for s in grid) + sum(s >= 24.0 for s in grid)
    assert len(score.silent) == silent > 5
    assert "begins at 0 s" in score.silent and "ends at 25 s" in score.silent
    assert score.total + score.straddling + score.repeats + silent == 2 * len(grid)
    contract = report.as_json()
    assert contract["chunks"] == {"total": score.total, "correct": score.correct}
    assert contract["paper"]["clean"]["silent"] == silent
    print_report(report)
    said = capsys.readouterr().out
    assert f"of {score.total} chunks inside one section" in said
    assert f"{silent} silent" in said and f"and {silent - 5} more (--json has all)" in said


def test_wrong_chunks_of_the_experiment_are_named_and_how_many_more_there_are(capsys):
    policy, score = policies_by_length(["a", "b"]), PaperScore()
    nothing = np.zeros(1, np.float32)
    answers = [
        MatchResult(),
        MatchResult("a", 5.0),
        *[MatchResult("b", 5.0, accepted=True)] * 5,
    ]
    for answer in answers:
        query = Query("clean", "a", 5.0, 0.0, nothing, False)
        score.add(query, answer, policy, lambda _query, _result: False)
    print_report(ChunkReport(paper={"clean": score}))
    said = capsys.readouterr().out
    assert "a at 5 s: nothing found; a at 5 s: not accepted (best is a at 5.0 s)" in said
    assert "taken for b at 5.0 s; and 2 more (--json has all)" in said
    assert len(score.shares()["wrong"]) == 7


def test_the_tables_fit_into_80_columns_and_unknown_kin_is_no_figure(capsys):
    report = ChunkReport(query_ms=[1.0])
    for name in ("band300_3400", "clean"):
        for suffix in ("", SHORT):
            report.conditions[name + suffix] = ConditionScore(12_345, 12_345, 12_345, 12_345)
    for name in LABELS:
        report.refused[name] = FalseAccepts(12_345, 12_345, ["one"] * 9)
        report.refused[name + SHORT] = FalseAccepts(12_345, 0)
    print_report(report)
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    for label in ("band300_3400", *LABELS.values(), LABELS[KIN] + SHORT, "all, 3 s"):
        (row,) = [line.split() for line in lines if line.strip().startswith(f"{label}   ")]
        assert len(row) >= 7 and "\u2026" not in "".join(row)
    assert max(len(line) for line in lines if line.startswith((" ", "\u2500"))) <= 80
    cells = next(line.split() for line in lines if line.strip().startswith("silence   "))
    assert cells == ["silence", "12345", "12345", "100.00", "100.00", "-", "0"]
    assert " ".join(lines).count("--groups") == 1
    assert any(line.startswith("accepted, silence: one; ") and "4 more" in line for line in lines)
    assert report.as_json()["false_accepts"]["taken_for_kin"] is None
    report.has_groups = True
    assert report.as_json()["false_accepts"]["taken_for_kin"] == 0


def test_what_nobody_asked_for_has_no_figure(folder, capsys):
    options = ChunkOptions(folder / "music", per_shift=0, per_condition=0)
    eval_chunks(options, as_json=False)
    said = capsys.readouterr()
    assert "nan" not in said.out
    assert "query p50 -, p99 -; place p50 -, p99 -" in " ".join(said.out.split())
    assert "indexed: 3 of 3" in said.err and "asked for what is known: 1 of 3" in said.err
    eval_chunks(options, as_json=True)
    (line,) = capsys.readouterr().out.splitlines()
    answer = json.loads(line, parse_constant=lambda text: pytest.fail(f"{text} is no JSON"))
    assert answer["query_ms"] == {"p50": None, "p99": None}


def test_clips_without_a_lock_have_no_time_to_it():
    score = StreamScore(n=4, lock_s=[1.0, float("inf"), 2.0, float("inf")])
    assert score.shares()["first_lock_s"] == {"p50": None, "p95": None}
    score = StreamScore(n=3, lock_s=[1.0, float("inf"), 2.0])
    assert score.shares()["first_lock_s"] == {"p50": 2.0, "p95": None}


def test_a_clip_that_outlasts_its_music_is_counted_apart():
    music = make_music(0, 30.0)
    fading = np.concatenate([music[: 12 * RATE], np.zeros(18 * RATE, np.float32)])
    degradation = next(d for d in degradations(None) if d.name == "white10")
    for samples, least, most in ((music, 0, 0), (fading, 1, 39)):
        score = StreamScore()
        piece = Recording("piece", samples, RATE)
        heard = list(clips(piece, degradation, 40, 3, score))
        assert len(heard) + score.ended == 40
        assert least <= score.ended <= most
        for start_s, clip in heard:
            end = round((start_s + 10.0) * RATE)
            assert np.abs(samples[end - RATE : end]).max() > 1e-3
            assert len(clip.samples) == 10 * RATE


def test_a_lock_on_a_foreign_stream_is_told_with_what_played():
    music = [Recording(f"piece{seed}", make_music(seed, 24.0), RATE) for seed in range(2)]
    heard = np.concatenate([np.zeros(3 * RATE, np.float32), music[1].samples[5 * RATE : 17 * RATE]])
    parts = [Part(0.0, "pause", 0.0, 1.0), Part(3.0, "cover", 5.0, 1.0)]
    stream = ForeignStream(Recording("foreign", heard, RATE), parts)
    count = LockCount()
    matcher = AlignmentMatcher(make_index(music))
    count_locks(matcher, stream, lambda query, result: False, count, Cost())
    (lock,) = count.locks
    assert not count.elsewhere
    name, at_s, taken_for = re.fullmatch(r"(\w+) at ([\d.]+) s taken for (\w+)", lock).groups()
    assert (name, taken_for) == ("cover", "piece1")
    assert 5.5 < float(at_s) < 10.0


@pytest.mark.parametrize("is_copy", [True, False])
def test_a_lock_on_the_identical_recording_under_another_name_is_counted_apart(is_copy):
    """Else it is the same notes in another room: as like to the matcher, and no copy."""
    music = [Recording(f"piece{seed}", make_music(seed, 24.0), RATE) for seed in range(2)]
    played = music[1].samples
    if not is_copy:
        room = np.random.default_rng(1).normal(size=RATE // 20)
        played = fftconvolve(played, room / np.linalg.norm(room))[: len(played)].astype(np.float32)
    parts = [Part(0.0, "cover", 5.0, 1.0)]
    stream = ForeignStream(Recording("foreign", played[5 * RATE : 17 * RATE], RATE), parts)
    sounds = {"cover": played, **{piece.name: piece.samples for piece in music}}
    places = Places({name: ft.to_matcher_rate(s, RATE) for name, s in sounds.items()})
    count = LockCount()
    matcher = AlignmentMatcher(make_index(music))
    count_locks(matcher, stream, places.is_same_sound, count, Cost())
    assert (len(count.locks), len(count.elsewhere)) == ((0, 1) if is_copy else (1, 0))


def test_where_a_sound_of_a_foreign_stream_comes_from_is_known_to_the_second():
    """Each sound is a ramp, so that a sample tells where it comes from."""
    rate = 8_000
    ramps = [
        Recording(name, first + np.arange(20 * rate, dtype=np.float32) / rate, rate)
        for name, first in (("dog", 100.0), ("bell", 200.0))
    ]
    stream = foreign_stream(ramps, 40.0, seed=3)
    assert len(stream.sound.samples) == 40 * rate and len(stream.parts) >= 3
    assert {part.name for part in stream.parts} == {"dog", "bell"}
    ends = [*[part.start_s for part in stream.parts[1:]], 40.0]
    for part, end_s in zip(stream.parts, ends, strict=True):
        late_s = 0.75 * (end_s - part.start_s)
        name, at_s = stream.playing(part.start_s + late_s).removesuffix(" s").split(" at ")
        assert name == part.name
        assert float(at_s) == pytest.approx(part.from_s + late_s * part.factor, abs=0.06)
        assert part.from_s + (end_s - part.start_s) * part.factor <= 20.01
