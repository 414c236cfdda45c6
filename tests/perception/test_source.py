"""Files as sound on a clock."""

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from downbeat.perception.errors import PerceptionError
from downbeat.perception.source import FileSource, Recording, Ring, audio_files, load_recording

RAMP = Recording("ramp", np.arange(16_000, dtype=np.float32) / 16_384, 16_000)
NOISE = Recording("noise", np.random.default_rng(0).random(44_100, np.float32) - 0.5, 44_100)


@given(st.lists(st.integers(0, 1_500_000), min_size=1, max_size=20))
def test_nothing_is_heard_before_it_sounds_and_nothing_twice(times):
    source = FileSource(RAMP, 1000)
    heard = []
    latest = 0
    for utime in times:
        latest = max(latest, utime)
        for block in source.read(utime):
            assert block.utime == 1000 + len(heard) * 1_000_000 // 16_000
            heard += block.samples.tolist()
        assert len(heard) * 1_000_000 <= max(0, latest - 1000) * 16_000
    assert heard == RAMP.samples[: len(heard)].tolist()


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(1, 300_000), max_size=20))
def test_every_pattern_of_steps_fills_the_ring_with_the_same(steps):
    rings = []
    for pattern in ([50_000] * 20, steps):
        source, ring, utime = FileSource(NOISE, 1000), Ring(0.7), 1000
        for step in [*pattern, 2_000_000]:
            utime += step
            for block in source.read(utime):
                ring.append(block.samples, block.utime, block.follows)
        assert source.is_finished and source.heard_utime == ring.last_utime
        rings.append(ring)
    assert np.array_equal(rings[0].last(1.0), rings[1].last(1.0))
    assert rings[0].last_utime == rings[1].last_utime == 1_001_000
    assert rings[0].num_gaps == rings[1].num_gaps == 0


def test_ring_keeps_the_newest():
    ring = Ring(1.0, 10)
    for start in range(0, 30, 5):
        ring.append(np.arange(start, start + 5, dtype=np.float32))
    assert ring.last(0.3).tolist() == [27, 28, 29]
    assert ring.seconds == 1.0


@pytest.mark.parametrize("suffix", ["wav", "flac", "ogg", "mp3"])
def test_common_formats_are_read(tmp_path, suffix):
    path = tmp_path / f"tone.{suffix}"
    stereo = 0.2 * np.sin(np.arange(44_100) / 20.0)[:, None].repeat(2, 1)
    soundfile.write(path, stereo, 44_100)
    recording = load_recording(path)
    assert recording.duration_s == pytest.approx(1.0, abs=0.1)
    assert recording.samples.ndim == 1


def test_missing_foreign_and_empty_files_are_one_sentence(tmp_path):
    with pytest.raises(PerceptionError, match=r"does not exist; valid are .wav"):
        load_recording(tmp_path / "none.wav")
    (tmp_path / "text.wav").write_text("not sound")
    with pytest.raises(PerceptionError, match=r"text.wav cannot be read: it is damaged, or not"):
        load_recording(tmp_path / "text.wav")
    (tmp_path / "text.txt").write_text("not sound")
    with pytest.raises(PerceptionError, match=r"text.txt is not an audio file .*; valid are .wav"):
        load_recording(tmp_path / "text.txt")
    with pytest.raises(PerceptionError, match=r"is a folder, and one audio file is wanted; valid"):
        load_recording(tmp_path)
    soundfile.write(tmp_path / "empty.wav", np.zeros(0), 44_100)
    with pytest.raises(PerceptionError, match="no usable sound"):
        load_recording(tmp_path / "empty.wav")
    (tmp_path / "quiet").mkdir()
    with pytest.raises(PerceptionError, match="holds no audio file"):
        audio_files(tmp_path / "quiet")
