"""The matcher: right track, right place, and nothing where there is nothing."""

import numpy as np
import pytest
import soxr
from synthetic_music import RATE, make_music, make_song

from downbeat.perception.alignment import MAX_WIDTH, CoarseScan, FineAligner, Heard
from downbeat.perception.errors import PerceptionError
from downbeat.perception.features import features as matcher_features
from downbeat.perception.features import to_matcher_rate
from downbeat.perception.index import (
    DECOY_PLACES,
    PAD_FRAMES,
    QUANTUM,
    coarse,
    coarse_of_fine,
    make_decoys,
)
from downbeat.perception.matcher import AlignmentMatcher
from downbeat.perception.source import audio_files, load_recording
from downbeat.perception.verdict import learned
from downbeat.tools.conditions import pink


def window(music, name, start_s, seconds):
    return music[name][round(start_s * RATE) : round((start_s + seconds) * RATE)]


def features(samples, rate):
    return matcher_features(to_matcher_rate(samples, rate))


@pytest.mark.parametrize("seconds", [1.25, 2.0, 5.0])
def test_windows_are_found_at_their_place(matcher, music, seconds):
    rng = np.random.default_rng(1)
    accepted = total = 0
    for name in music:
        for start_s in rng.uniform(0, 34, 10):
            result = matcher.query(window(music, name, start_s, seconds), RATE)
            total += 1
            accepted += result.accepted
            assert result.track == name
            if result.accepted:
                assert result.tau_s == pytest.approx(start_s, abs=0.08)
    assert accepted >= (0.97 if seconds >= 2.0 else 0.9) * total


def test_shifting_the_window_shifts_the_answer(matcher, music):
    first = matcher.query(window(music, "piece1", 10.0, 3.0), RATE)
    for shift_s in (0.005, 0.05, 0.333, 4.0):
        later = matcher.query(window(music, "piece1", 10.0 + shift_s, 3.0), RATE)
        assert later.tau_s - first.tau_s == pytest.approx(shift_s, abs=0.015)


@pytest.mark.parametrize("rate", [16_000, 44_100, 48_000])
def test_any_sample_rate_finds_the_same_place(matcher, music, rate):
    sound = soxr.resample(window(music, "piece1", 10.0, 3.0), RATE, rate)
    result = matcher.query(sound, rate)
    assert result.accepted
    assert (result.track, result.tau_s) == ("piece1", pytest.approx(10.0, abs=0.02))


def test_too_low_a_rate_and_an_empty_index_are_one_sentence(matcher):
    with pytest.raises(PerceptionError, match="8000 Hz"):
        matcher.query(np.ones(4000, np.float32), 4000)
    with pytest.raises(PerceptionError, match="holds no track"):
        AlignmentMatcher().query(np.ones(4 * RATE, np.float32), RATE)


def test_loudness_does_not_matter(matcher, music):
    sound = window(music, "piece2", 7.0, 3.0)
    loud, quiet = matcher.query(sound, RATE), matcher.query(0.02 * sound, RATE)
    assert quiet.accepted
    assert quiet.tau_s == pytest.approx(loud.tau_s, abs=1e-3)


def test_noise_at_zero_decibels_does_not_hide_the_track(matcher, music):
    sound = window(music, "piece0", 12.0, 5.0)
    noise = np.random.default_rng(3).standard_normal(len(sound)).astype(np.float32)
    noise *= np.sqrt((sound**2).mean())
    result = matcher.query(sound + noise, RATE)
    assert result.accepted and result.track == "piece0"
    assert result.tau_s == pytest.approx(12.0, abs=0.08)


def test_faster_playing_is_noticed(matcher, music):
    sound = window(music, "piece0", 8.0, 5.2)
    faster = soxr.resample(sound, RATE * 1.02, RATE)
    result = matcher.query(faster[: 5 * RATE], RATE)
    assert result.track == "piece0"
    assert result.rate == pytest.approx(1.02, abs=0.011)


@pytest.mark.parametrize(
    "sound",
    [
        np.zeros(3 * RATE, np.float32),
        np.random.default_rng(0).standard_normal(3 * RATE).astype(np.float32) * 0.1,
        0.3 * np.sin(2 * np.pi * 440 * np.arange(3 * RATE) / RATE).astype(np.float32),
        make_music(99, 3.0),
        np.zeros(10, np.float32),
        np.full(3 * RATE, np.nan, np.float32),
        np.full(3 * RATE, 0.5, np.float32),
    ],
    ids=["silence", "noise", "tone", "unknown music", "ten samples", "not finite", "constant"],
)
def test_what_is_not_in_the_catalogue_is_not_accepted(matcher, sound):
    result = matcher.query(sound, RATE)
    assert not result.accepted
    assert np.isfinite([result.tau_s, result.confidence, result.similarity]).all()


def test_a_catalogue_of_one_track_knows_it_and_refuses_others(music):
    """Without another track to compare with, decoys say what chance can do."""
    single = AlignmentMatcher()
    single.add("piece0", music["piece0"], RATE)
    for start_s in range(2, 34, 4):
        own = single.query(window(music, "piece0", start_s, 2.0), RATE)
        assert own.accepted and own.tau_s == pytest.approx(start_s, abs=0.05)
        assert own.runner_up == ""
        for stranger in ("piece1", "piece2"):
            for seconds in (1.0, 2.0, 5.0):
                assert not single.query(window(music, stranger, start_s, seconds), RATE).accepted


def test_decoys_resemble_the_catalogue_but_are_not_in_it(matcher):
    tracks = matcher.index.fine
    decoys = make_decoys(tracks)
    assert sum(len(coarse_of_fine(decoy)) for decoy in decoys) >= DECOY_PLACES
    for track, decoy in zip(tracks, decoys):
        assert sorted(np.abs(decoy).sum(1)) == sorted(np.abs(track).sum(1))
        assert not np.array_equal(decoy, track)


def test_saved_index_answers_the_same(matcher, music, tmp_path):
    matcher.save(tmp_path / "index.bin")
    loaded = AlignmentMatcher.load(tmp_path / "index.bin")
    sound = window(music, "piece1", 20.0, 2.0)
    assert loaded.query(sound, RATE) == matcher.query(sound, RATE)


def test_agreement_is_high_at_the_place_and_low_elsewhere(matcher, music):
    sound = window(music, "piece0", 15.0, 1.0)
    here, correction_s = matcher.agreement(sound, RATE, "piece0", 15.01)
    assert here > 0.6
    assert correction_s == pytest.approx(-0.01, abs=0.015)
    assert matcher.agreement(sound, RATE, "piece0", 25.0)[0] < 0.35
    assert matcher.agreement(sound, RATE, "piece1", 15.0)[0] < 0.35


def test_windows_too_short_to_know_much_must_stand_higher():
    accept = learned().accept
    assert accept.of(1.0) > accept.of(1.25) > accept.of(1.5) > accept.of(2.0)


@pytest.mark.parametrize("seconds", [1.0, 3.0, 10.0])
def test_the_scan_by_spectra_is_the_sliding_correlation(matcher, music, seconds):
    tracks = matcher.index.coarse
    scan = CoarseScan(tracks)
    query = coarse(features(window(music, "piece1", 9.3, seconds), RATE))[:MAX_WIDTH]
    scores, chance = scan.scores(query)
    assert scores.shape == (sum(len(track) for track in tracks),)
    number, at = 1, 40
    for place in (0, 7, at, len(tracks[number]) - len(query)):
        part = tracks[number][place : place + len(query)].astype(np.float32) / QUANTUM
        expected = (part * query).sum() / np.sqrt((query**2).sum())
        score = scores[scan.starts[number] + place]
        likeness = expected / np.sqrt((part**2).sum())
        assert abs(score) <= abs(likeness) + 1e-4  # quiet places are not blown up
        assert score == pytest.approx(likeness, abs=0.02) or (part**2).mean() < 0.1
    beyond = scores[scan.starts[number] + len(tracks[number]) - len(query) + 1 : scan.starts[2]]
    assert not beyond.any()
    assert 0.0 < chance < 0.3


@pytest.mark.parametrize("seconds", [1.0, 2.5, 5.0])
def test_alignment_in_groups_is_the_sum_along_a_line(matcher, music, seconds):
    values = features(window(music, "piece0", 12.0, seconds), RATE)
    aligner = FineAligner(matcher.index.fine, matcher.index.power)
    first = round(12.0 / 0.04) + PAD_FRAMES
    fit = aligner.align(Heard(values), 0, first + 2, 4, (1.0,))
    assert fit.tau_s == pytest.approx(12.0, abs=0.01)
    part = matcher.index.fine[0][first : first + 2 * len(values) : 2].astype(np.float32)
    likeness = (part * values).sum() / np.sqrt((part**2).sum() * (values**2).sum())
    assert fit.similarity == pytest.approx(likeness, abs=0.02)


def test_a_quiet_beginning_is_known_as_well_as_the_loud_part(music):
    """Twelve seconds at a hundredth of the level: no floor of the whole track may hide it."""
    sound = music["piece0"].copy()
    sound[: 12 * RATE] *= 0.01
    quiet = AlignmentMatcher()
    for name, samples in {**music, "piece0": sound}.items():
        quiet.add(name, samples, RATE)
    for start_s in (1.0, 4.0, 7.0):
        result = quiet.query(sound[round(start_s * RATE) : round((start_s + 3.0) * RATE)], RATE)
        assert result.accepted and result.track == "piece0"
        assert result.tau_s == pytest.approx(start_s, abs=0.03)


def test_a_passage_played_twice_is_named_as_a_repeat():
    song = AlignmentMatcher()
    song.add("song", make_song(60, 10.0), RATE)
    song.add("other", make_music(61, 30.0), RATE)
    sound = make_song(60, 10.0)[3 * RATE : 6 * RATE]
    result = song.query(sound, RATE)
    assert sorted([result.tau_s, *result.repeats]) == pytest.approx([3.0, 23.0], abs=0.03)
    assert song.query(make_song(60, 10.0)[13 * RATE : 16 * RATE], RATE).repeats == ()


def test_a_riff_is_found_at_its_own_place_and_not_at_a_likeness():
    """Thirty bars alike but for a soft melody, and windows between two places of the scan."""
    bar = np.pad(make_music(80, 2.2), (0, RATE))[: round(2.2 * RATE)]
    sound = np.tile(bar, 30)
    sound = sound + np.float32(0.2) * make_music(81, 70.0)[: len(sound)]
    riff = AlignmentMatcher()
    riff.add("riff", sound, RATE)
    riff.add("other", make_music(90, 30.0), RATE)
    for start_s in np.arange(3.04, 57.0, 2.26):
        result = riff.query(sound[round(start_s * RATE) : round((start_s + 4.0) * RATE)], RATE)
        assert result.accepted and result.tau_s == pytest.approx(start_s, abs=0.05)


def test_a_window_that_two_tracks_share_is_accepted_for_neither_and_names_both():
    from downbeat.tools.passages import find_passages

    shared = make_music(50, 8.0)
    sounds = {
        "early": np.concatenate([make_music(51, 10.0), shared, make_music(52, 6.0)]),
        "late": np.concatenate([make_music(53, 14.0), shared]),
    }
    twins = AlignmentMatcher()
    for name, samples in sounds.items():
        twins.add(name, samples, RATE)
    twins.index.shared = find_passages(twins.index)
    twins.finish()
    result = twins.query(window(sounds, "early", 12.0, 4.0), RATE)
    ((other, other_s),) = result.twins
    assert not result.accepted and {result.track, other} == {"early", "late"}
    assert sorted([result.tau_s, other_s]) == pytest.approx([12.0, 16.0], abs=0.03)
    for name, start_s in (("early", 2.0), ("early", 19.0), ("late", 5.0)):
        result = twins.query(window(sounds, name, start_s, 4.0), RATE)
        assert result.accepted and (result.track, result.twins) == (name, ())


def test_accepted_is_what_has_a_confidence_above_zero(matcher, music):
    """So that hearing.toml's `min_confidence = 0` asks for no more than the rule itself."""
    rng = np.random.default_rng(0)
    results = []
    for level in (0.0, 0.05, 0.2, 0.5, 1.5):
        for start_s in (3.0, 17.0):
            for seconds in (1.25, 3.0, 5.0):
                sound = window(music, "piece1", start_s, seconds)
                noise = level * rng.standard_normal(len(sound)).astype(np.float32)
                results.append(matcher.query(sound + noise, RATE))
    assert {r.accepted for r in results} == {True, False}
    for result in results:
        assert result.accepted == (result.confidence > 0.0)
        assert result.doubtful or result.confidence > 1.0


def test_a_lock_asks_more_than_one_window_alone():
    for seconds in (1.0, 1.25, 2.0, 3.0, 5.0, 8.0):
        assert learned().lock.of(seconds) > learned().accept.of(seconds) + 0.5


def drum_loop(bpm, seconds=30.0):
    """Return sixteenths of a drum machine that always plays the same pattern."""
    rng = np.random.default_rng(0)
    t = np.arange(round(0.25 * RATE)) / RATE
    hiss = rng.standard_normal(len(t))
    sounds = [
        np.sin(2 * np.pi * 60.0 * t) * np.exp(-t / 0.08),  # kick
        0.5 * (hiss + np.sin(2 * np.pi * 190.0 * t)) * np.exp(-t / 0.06),  # snare
        0.4 * np.diff(hiss, append=0.0) * np.exp(-t / 0.02),  # hat
        0.4 * np.sin(2 * np.pi * 840.0 * t) * np.exp(-t / 0.03),  # cowbell
    ]
    pattern = rng.integers(0, 6, 32)
    loop = np.zeros(round(seconds * RATE) + RATE)
    for step in range(int(seconds * bpm / 15.0)):
        number = int(pattern[step % len(pattern)])
        if number < len(sounds):
            first = round(step * 15.0 / bpm * RATE)
            loop[first : first + len(t)] += sounds[number]
    return (0.2 * loop / np.abs(loop).max())[: round(seconds * RATE)].astype(np.float32)


@pytest.mark.parametrize(
    "played, start_s",
    [
        (drum_loop(114.0), 2.0),
        (soxr.resample(drum_loop(120.0), RATE, RATE / 0.95), 8.0),
        (soxr.resample(drum_loop(120.0), RATE, RATE / 1.05), 8.0),
    ],
    ids=["slower", "slower and lower", "faster and higher"],
)
def test_a_brief_window_that_fits_only_at_another_speed_is_not_enough_for_a_lock(played, start_s):
    """It may be another loop of the same drum machine; a longer one tells the speed."""
    matcher = AlignmentMatcher()
    matcher.add("loop", drum_loop(120.0), RATE)
    for seed in range(3):
        matcher.add(f"other{seed}", make_music(seed, 30.0), RATE)
    sounds = {"played": played.astype(np.float32)}
    brief = matcher.query(window(sounds, "played", start_s, 2.0), RATE)
    longer = matcher.query(window(sounds, "played", start_s, 4.0), RATE)
    for result in (brief, longer):
        assert result.track == "loop" and result.accepted
        assert result.confidence > 4.0 and abs(result.rate - 1.0) > 0.02
    assert brief.doubtful and not longer.doubtful


def test_a_brief_window_of_the_track_itself_is_enough_whatever_speed_fits_it_best(matcher, music):
    results = [
        matcher.query(window(music, name, start_s, 1.25), RATE)
        for name in ("piece0", "piece1", "piece2")
        for start_s in np.arange(3.0, 30.0, 0.7).tolist()
    ]
    off = [r for r in results if abs(r.rate - 1.0) > 0.02 and r.confidence > 3.0]
    assert len(off) > 5
    assert not any(r.doubtful for r in off)


def chords(seed, seconds=32.0):
    """An organ's chords of eight seconds, each swelling out of the one before, (n,)."""
    rng = np.random.default_rng(seed)
    sound = np.zeros(round((seconds + 12.0) * RATE))
    t = np.arange(12 * RATE) / RATE
    swell = np.interp(t, [0.0, 4.0, 8.0, 12.0], [0.0, 1.0, 1.0, 0.0])
    for begin_s in np.arange(0.0, seconds, 8.0):
        first = round(begin_s * RATE)
        for note in rng.choice(36, 4, replace=False):
            hz = 110.0 * 2.0 ** (note / 12)
            for partial in range(1, int(min(8.0, 7000.0 / hz)) + 1):
                phase = 2.0 * np.pi * partial * hz * t + rng.uniform(0.0, 2.0 * np.pi)
                sound[first : first + len(t)] += swell * np.sin(phase) / partial
    return (0.5 * sound / np.abs(sound).max())[2 * RATE : -8 * RATE].astype(np.float32)


def test_pieces_of_chords_that_last_are_told_apart_in_noise():
    """All that changes in them is slower than what the features take for the room."""
    matcher = AlignmentMatcher()
    pieces = {f"organ{seed}": chords(seed) for seed in range(10)}
    for name, samples in pieces.items():
        matcher.add(name, samples, RATE)
    rng = np.random.default_rng(3)
    found = []
    for name, samples in pieces.items():
        for start_s in (9.5, 17.0, 24.0):
            part = samples[round(start_s * RATE) : round((start_s + 5.0) * RATE)]
            result = matcher.query(pink(0.0)(part, RATE, rng).astype(np.float32), RATE)
            found.append(result.track == name)
            assert result.track == name or not result.accepted
    assert np.mean(found) > 0.9


def test_another_pitch_does_not_cost_the_place(matcher, music):
    from downbeat.tools.conditions import pitch

    sound = window(music, "piece2", 11.0, 5.0)
    for factor in (0.96, 1.04):
        heard = pitch(factor)(sound, RATE, np.random.default_rng(0))
        result = matcher.query(heard, RATE)
        assert result.accepted and result.tau_s == pytest.approx(11.0, abs=0.08)


def test_silent_or_short_tracks_are_not_indexed():
    with pytest.raises(PerceptionError, match="silent or shorter"):
        AlignmentMatcher().add("nothing", np.zeros(5 * RATE, np.float32), RATE)


def test_real_recordings_are_found_in_two_seconds(real_music):
    files = audio_files(real_music)[:6]
    recordings = [load_recording(path) for path in files]
    real = AlignmentMatcher()
    for recording in recordings:
        rate = recording.sample_rate_hz
        real.add(recording.name, recording.samples[: 60 * rate], rate)
    rng = np.random.default_rng(5)
    right = total = 0
    for recording in recordings:
        for start_s in rng.uniform(2, min(50, recording.duration_s - 4), 10):
            rate = recording.sample_rate_hz
            sound = recording.samples[round(start_s * rate) : round((start_s + 2.0) * rate)]
            if np.sqrt((sound**2).mean()) < 0.01:
                continue
            result = real.query(sound, rate)
            total += 1
            right += result.accepted and result.track == recording.name
            assert not (result.accepted and result.track != recording.name)
    assert right >= 0.9 * total


def test_a_piece_of_single_sounds_is_known_and_is_not_heard_in_every_click():
    """Most of such a window is pause, and pauses are alike: words, hums and clicks are no match."""
    rng = np.random.default_rng(4)
    piece = np.zeros(40 * RATE, np.float32)
    t = np.arange(RATE // 5) / RATE
    for start in np.cumsum(rng.uniform(0.6, 2.0, 24)):
        note = 0.3 * np.sin(2 * np.pi * rng.uniform(300, 3000) * t) * np.exp(-t * 25)
        piece[round(start * RATE) :][: len(t)] += note[: len(piece) - round(start * RATE)]
    sparse = AlignmentMatcher()
    sparse.add("sparse", piece, RATE)
    sparse.add("piece", make_music(60, 40.0), RATE)
    own = [sparse.query(piece[s * RATE : (s + 5) * RATE], RATE) for s in range(2, 24, 4)]
    assert all(result.track == "sparse" for result in own)
    assert sum(result.accepted for result in own) >= 5
    strangers = []
    for _ in range(12):
        sound = 1e-4 * rng.standard_normal(8 * RATE)
        for start in np.cumsum(rng.uniform(0.4, 1.5, 5)):
            hum = np.sin(2 * np.pi * rng.uniform(100, 2500) * t) * np.exp(-t * rng.uniform(2, 30))
            sound[round(start * RATE) :][: len(t)] += 0.3 * hum
        strangers.append(sound.astype(np.float32))
    strangers += [0.1 * np.sin(2 * np.pi * f * np.arange(8 * RATE) / RATE) for f in (440, 1000)]
    for sound in strangers:
        for seconds in (1.0, 1.25, 2.0, 3.0, 5.0):
            assert not sparse.query(sound[: round(seconds * RATE)], RATE).accepted
