"""Sound out without a robot."""

import sys

import numpy as np
import pytest
import soundfile

from downbeat.perception.errors import PerceptionError
from downbeat.perception.speaker import FileSpeaker, LocalSpeaker

TONE = np.full(8000, 1000, np.int16)
START = 10_000_000


def test_file_holds_what_sounded_when_it_sounded(tmp_path):
    speaker = FileSpeaker(tmp_path / "out.wav", START)
    assert speaker.play(TONE, START + 1_000_000) == 0.5
    for at in range(1_000_000, 3_000_001, 50_000):
        speaker.update(START + at)
    speaker.close()
    samples, rate = soundfile.read(tmp_path / "out.wav", dtype="int16")
    assert rate == 16_000 and len(samples) == 48_000
    assert not samples[:16_000].any() and (samples[16_000:24_000] == 1000).all()
    assert not samples[24_000:].any()


def test_stop_cuts_and_a_new_sound_replaces_the_old(tmp_path):
    speaker = FileSpeaker(tmp_path / "out.wav", START)
    speaker.play(TONE, START)
    speaker.update(START + 100_000)
    assert speaker.is_playing(START + 100_000)
    speaker.stop()
    assert not speaker.is_playing(START + 100_000)
    speaker.set_volume(0.5)
    speaker.play(TONE, START + 1_000_000)
    speaker.update(START + 2_000_000)
    speaker.close()
    samples, _ = soundfile.read(tmp_path / "out.wav", dtype="int16")
    assert (samples[:1600] == 1000).all() and not samples[1600:16_000].any()
    assert (samples[16_000:24_000] == 500).all()


def test_lights_are_noted_once_per_change(tmp_path):
    speaker = FileSpeaker(tmp_path / "out.wav", START)
    for what in ("listening", "listening", "dancing", "listening"):
        speaker.show(what)
    assert speaker.shown == ["listening", "dancing", "listening"]
    speaker.close()


def test_what_cannot_be_played_is_refused(tmp_path):
    speaker = FileSpeaker(tmp_path / "out.wav", START)
    with pytest.raises(PerceptionError, match="one row of int16"):
        speaker.play(np.zeros(10, np.float32), START)
    with pytest.raises(PerceptionError, match="0 to 1"):
        speaker.set_volume(2.0)
    speaker.close()
    with pytest.raises(PerceptionError, match="cannot be written"):
        FileSpeaker(tmp_path / "no" / "such" / "out.wav", START)


def test_no_portaudio_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(PerceptionError, match="libportaudio2"):
        LocalSpeaker()
