"""The composer: notation, instruments in tune, levels, the same bytes every time."""

import importlib

import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st

from downbeat.catalog.tracks import load_tracks
from downbeat.tools.composer import effects, instruments, score, store, waves
from downbeat.tools.composer.desk import CEILING, Desk
from downbeat.tools.composer.form import BEATS_PER_BAR
from downbeat.tools.composer.pieces import Piece
from downbeat.tools.errors import ToolError

EXCERPT_BEATS = 8.0
SOLO = [
    "soft_lead",
    "pluck",
    "synth_bass",
    "organ",
    "piano",
    "bell",
    "surf_guitar",
    "muted_guitar",
    "electric_bass",
    "slap_bass",
    "upright_bass",
    "brass",
    "flute",
]


def written_phrases():
    """Every melody of every piece, as (piece, name, bar)."""
    for piece in store.COMPOSITIONS:
        module = importlib.import_module(f"downbeat.tools.composer.{piece}")
        for name, value in vars(module).items():
            texts = value if isinstance(value, tuple) else (value,)
            for text in texts:
                if name.isupper() and isinstance(text, str) and "/" in text:
                    for bar in text.split("|"):
                        yield piece, name, bar


def test_every_written_bar_is_full():
    bars = list(written_phrases())
    assert len(bars) > 80
    for piece, name, bar in bars:
        assert score.phrase_beats(bar) == BEATS_PER_BAR, (piece, name, bar)


@pytest.mark.parametrize("name", store.COMPOSITIONS)
def test_every_bar_has_its_chords(name):
    module = importlib.import_module(f"downbeat.tools.composer.{name}")
    table = getattr(module, "CHORDS", None) or module.HALVES
    per_bar = 1 if hasattr(module, "CHORDS") else 2
    for section, symbols in table.items():
        assert len(symbols.split()) == per_bar * module.FORM.bars(section), section
        assert all(len(score.chord(symbol)) >= 3 for symbol in symbols.split())


@given(st.integers(0, 11), st.floats(30.0, 90.0))
def test_nearest_pitch_of_a_class_is_at_most_a_tritone_away(pitch_class, centre):
    pitch = score.near(pitch_class, centre)
    assert pitch % 12 == pitch_class
    assert abs(pitch - centre) <= 6.5


def test_phrase_keeps_rests_accents_and_order():
    notes = score.phrase("A4/1 -/.5 | C5!/2", 8.0, velocity=0.5, transpose=-12)
    assert [(n.beat, n.pitch) for n in notes] == [(8.0, 57), (9.5, 60)]
    assert notes[1].velocity > notes[0].velocity


@pytest.mark.parametrize("word", ["H4", "A", "4", "a4"])
def test_wrong_pitch_says_how_to_write_one(word):
    with pytest.raises(ToolError, match="write e.g. A4"):
        score.pitch_of(word)


def test_wrong_chord_says_how_to_write_one():
    with pytest.raises(ToolError, match="write e.g. Am"):
        score.chord("Hm13")


@pytest.mark.parametrize("name", SOLO)
@pytest.mark.parametrize("hz", [110.0, 440.0])
def test_instrument_is_in_tune_and_does_not_click(name, hz):
    sound = getattr(instruments, name)(hz, 0.8)
    assert np.isfinite(sound).all()
    assert abs(sound[-1]) < 1e-3
    assert abs(sound[0]) < 0.1
    spectrum = np.abs(np.fft.rfft(sound[500:] * np.hanning(len(sound) - 500), 1 << 19))
    frequency = np.fft.rfftfreq(1 << 19, 1.0 / waves.RATE_HZ)
    band = (frequency > 0.95 * hz) & (frequency < 1.05 * hz)
    found_hz = frequency[band][spectrum[band].argmax()]
    assert abs(1200.0 * np.log2(found_hz / hz)) < 12.0  # cents


@given(st.integers(0, 1000), st.floats(0.1, 8.0))
def test_limiter_keeps_every_sample_below_the_ceiling(seed, level):
    random = np.random.default_rng(seed)
    sound = level * random.standard_normal(4_000) * random.uniform(0.0, 1.0, 4_000) ** 4
    assert np.abs(effects.limit(sound, CEILING)).max() <= CEILING + 1e-9


def test_limiter_leaves_quiet_sound_alone():
    sound = 0.5 * waves.sine(200.0, 0.2)
    np.testing.assert_allclose(effects.limit(sound, CEILING), sound, atol=1e-12)


def test_ducking_is_deepest_on_the_onset_and_recovers():
    gain = effects.ducking(waves.count(1.0), [0.5], 0.8, 0.3)
    assert gain[waves.count(0.5)] == pytest.approx(0.2, abs=0.01)
    assert gain[0] == gain[-1] == 1.0
    assert np.abs(np.diff(gain)).max() < 0.01


def test_a_struck_drum_stands_on_its_beat():
    desk = Desk(120.0, 8.0, 0.5)
    stem = desk.stem().hit(lambda take: np.ones(10), [(3.0, 1.0)])
    assert np.flatnonzero(stem.samples)[0] == waves.count(1.5)


@pytest.mark.parametrize("name", store.COMPOSITIONS)
def test_excerpt_is_the_same_bytes_twice_and_is_sound(name):
    first, second = (store.compose(name, EXCERPT_BEATS) for _ in range(2))
    assert first.tobytes() == second.tobytes()
    assert first.dtype == np.float32
    assert np.isfinite(first).all()
    assert np.abs(first).max() <= CEILING + 1e-6
    assert 0.03 < np.sqrt(np.mean(first**2)) < 0.4
    assert abs(first[-1]) < 1e-4


def short_piece(calls):
    form = store.form("neon_parade")

    def play(desk):
        calls.append(1)
        return np.linspace(-0.5, 0.5, 44_100, dtype=np.float32)

    return Piece(form, play)


def test_a_piece_is_composed_once_and_read_from_the_cache_after_that(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setitem(store.PIECES, "neon_parade", short_piece(calls))
    path = store.composed_file("neon_parade", tmp_path)
    assert store.composed_file("neon_parade", tmp_path) == path
    assert len(calls) == 1
    assert path.name == "neon_parade.flac"
    assert [p.name for p in path.parent.iterdir()] == [path.name]
    recording = store.composed_recording("neon_parade", tmp_path)
    assert (recording.name, recording.sample_rate_hz) == ("neon_parade", 44_100)
    assert soundfile.info(path).subtype == "PCM_16"


def test_another_code_version_composes_again(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setitem(store.PIECES, "neon_parade", short_piece(calls))
    store.composed_file("neon_parade", tmp_path)
    monkeypatch.setattr(store, "code_version", lambda: "another")
    store.composed_file("neon_parade", tmp_path)
    assert len(calls) == 2


def test_unknown_composition_lists_the_known_ones(tmp_path):
    with pytest.raises(
        ToolError, match="'polka' is unknown; compositions are midnight_bones, neon"
    ):
        store.composed_file("polka", tmp_path)


def test_any_twenty_seconds_of_a_bundled_track_hold_a_rule_change():
    for name, track in load_tracks().items():
        for from_s in np.arange(0.0, track.duration_s - 20.0, 0.1):
            assert len(track.sections(from_s, from_s + 20.0)) >= 2, (name, from_s)


@pytest.mark.slow
@pytest.mark.parametrize("name", store.COMPOSITIONS)
def test_whole_piece_has_a_mastered_level_and_the_length_of_its_track_file(name):
    samples = store.compose(name)
    track = load_tracks()[name]
    assert len(samples) / waves.RATE_HZ == pytest.approx(track.duration_s, abs=0.01)
    assert 60.0 <= track.duration_s <= 90.0
    assert np.abs(samples).max() <= CEILING + 1e-6
    level_db = 20.0 * np.log10(np.sqrt(np.mean(samples.astype(np.float64) ** 2)))
    assert -17.0 < level_db < -13.0
    for start_s, end_s, _ in track.sections(0.0, track.duration_s):
        part = samples[waves.count(start_s) : waves.count(end_s)].astype(np.float64)
        assert 20.0 * np.log10(np.sqrt(np.mean(part**2))) > level_db - 6.0


@pytest.mark.slow
@pytest.mark.parametrize("name", store.COMPOSITIONS)
def test_beats_of_a_piece_are_where_its_track_file_says(name):
    from downbeat.perception.beats import estimate_grid

    grid = estimate_grid(store.compose(name), waves.RATE_HZ)
    written = load_tracks()[name].grid
    assert grid.tempo_bpm == pytest.approx(written.tempo_bpm, abs=0.02)
    # A salsa's accents stand between its beats; its finder may settle on a sixteenth.
    unit_s = 60.0 / written.tempo_bpm / (4 if name == "salsa_del_puerto" else 1)
    for beat in range(0, 120, 7):
        error_s = (grid.time_of(beat) + 0.5 * unit_s) % unit_s - 0.5 * unit_s
        assert abs(error_s) < 0.01
