"""Files as sound on a clock."""

import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st

from downbeat.perception.errors import PerceptionError
from downbeat.perception.source import FileSource, Recording, Ring, audio_files, load_recording

NOISE = Recording("noise", np.arange(44_100, dtype=np.float32), 44_100)


@given(st.lists(st.integers(0, 1_500_000), min_size=1, max_size=20))
def test_nothing_is_heard_before_it_sounds_and_nothing_twice(times):
    source = FileSource(NOISE, 1000)
    heard = []
    latest = 0
    for utime in times:
        latest = max(latest, utime)
        heard += source.read(utime).tolist()
        assert len(heard) <= max(0.0, (latest - 1000) * 1e-6) * 44_100
    assert heard == NOISE.samples[: len(heard)].tolist()


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
    with pytest.raises(PerceptionError, match="not an audio file"):
        load_recording(tmp_path / "text.wav")
    soundfile.write(tmp_path / "empty.wav", np.zeros(0), 44_100)
    with pytest.raises(PerceptionError, match="no usable sound"):
        load_recording(tmp_path / "empty.wav")
    (tmp_path / "quiet").mkdir()
    with pytest.raises(PerceptionError, match="holds no audio file"):
        audio_files(tmp_path / "quiet")
