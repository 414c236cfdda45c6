"""Bad sound is heard as well as it can be, or refused in one sentence; the listener lives on."""

import logging
import sys

import numpy as np
import pytest
import soundfile
import soxr
from fake_portaudio import FakePortAudio
from synthetic_music import RATE

from downbeat.lcm_types import audio_class_t, audio_source_t, music_match_t
from downbeat.perception.errors import PerceptionError
from downbeat.perception.listener import ListenerNode
from downbeat.perception.microphone import Microphone
from downbeat.perception.source import FileSource, Recording, load_recording
from downbeat.perception.source_spec import is_live, open_source
from downbeat.runtime.clock import SimClock
from downbeat.runtime.memq import MemqHub

CHANNELS = ("AUDIO_SOURCE", "AUDIO_CLASS", "MUSIC_MATCH")
SECONDS = 4.0


class Hall:
    """A listener on a source, and everything that it says."""

    def __init__(self, matcher, make_source):
        self.clock, hub = SimClock(), MemqHub()
        self.begin = self.clock.utime()
        bus = hub.endpoint("listener", self.clock)
        self.source = make_source(self.clock, bus)
        self.node = ListenerNode(bus, self.source, matcher)
        self.watcher = hub.endpoint("watcher", self.clock)
        self.watcher.subscribe(*CHANNELS)
        self.said = {channel: [] for channel in CHANNELS}

    def step(self):
        self.node.step(self.clock.utime())
        self.watcher.pump()
        for channel in CHANNELS:
            self.said[channel] += [received.msg for received in self.watcher.take(channel)]

    def run(self, seconds, step_us=50_000):
        end = self.clock.utime() + round(seconds * 1e6)
        while self.clock.utime() < end:
            self.clock.advance_to(self.clock.utime() + step_us)
            self.step()
        return self

    @property
    def locks(self):
        return [m for m in self.said["MUSIC_MATCH"] if m.lock == music_match_t.LOCKED]


@pytest.fixture(scope="module")
def piece(music):
    return music["piece1"][3 * RATE : round((3 + SECONDS) * RATE)]


def hear_file(matcher, path):
    def make(clock, _bus):
        return FileSource(load_recording(path), clock.utime())

    return Hall(matcher, make).run(SECONDS + 0.5)


def offset(sound):
    return 0.5 * sound + 0.45


def stereo(sound):
    return np.stack([sound, 0.2 * np.roll(sound, 40)], 1)


BAD_BUT_HEARD = {
    "clipped": (lambda x: np.clip(30.0 * x, -1.0, 1.0), RATE, "PCM_16"),
    "offset": (offset, RATE, "PCM_16"),
    "8 kHz": (lambda x: soxr.resample(x, RATE, 8_000), 8_000, "PCM_16"),
    "stereo": (stereo, RATE, "PCM_16"),
    "24 bit": (lambda x: x, RATE, "PCM_24"),
    "8 bit": (lambda x: x, RATE, "PCM_U8"),
    "beyond full scale": (lambda x: 40.0 * x, RATE, "FLOAT"),
    "quiet": (lambda x: 0.15 * x, RATE, "PCM_16"),
}


@pytest.mark.parametrize("kind", BAD_BUT_HEARD)
def test_music_in_a_bad_file_is_recognised_all_the_same(tmp_path, matcher, piece, kind):
    change, rate, subtype = BAD_BUT_HEARD[kind]
    path = tmp_path / "piece.wav"
    soundfile.write(path, change(piece), rate, subtype=subtype)
    hall = hear_file(matcher, path)
    assert hall.locks and {m.track for m in hall.locks} == {"piece1"}
    for msg in hall.locks:
        assert (msg.track_zero_utime - hall.begin) * 1e-6 == pytest.approx(-3.0, abs=0.05)
    assert hall.said["AUDIO_SOURCE"][-1].state == audio_source_t.FINISHED


@pytest.mark.parametrize("level", [0.0, 0.5, -1.0])
def test_silence_and_a_constant_voltage_are_nothing(tmp_path, matcher, level):
    path = tmp_path / "silence.wav"
    soundfile.write(path, np.full(4 * RATE, level), RATE)
    hall = hear_file(matcher, path)
    inside = [  # the edges of a voltage are a click
        m
        for m in hall.said["AUDIO_CLASS"]
        if 50_000 < m.window_start_utime - hall.begin < 2_900_000
    ]
    assert len(inside) > 5 and {m.label for m in inside} == {audio_class_t.SKIP}
    assert all(m.rms_dbfs <= -90.0 for m in inside)
    assert not hall.locks


@pytest.mark.parametrize("suffix", ["wav", "flac", "mp3"])
def test_a_file_that_was_cut_off_is_heard_as_far_as_it_goes(
    tmp_path, matcher, piece, suffix, caplog
):
    path = tmp_path / f"piece.{suffix}"
    soundfile.write(path, piece, RATE)
    content = path.read_bytes()
    path.write_bytes(content[: round(0.8 * len(content))])
    with caplog.at_level(logging.WARNING):
        recording = load_recording(path)
    assert 0.5 * SECONDS < recording.duration_s < 0.9 * SECONDS
    if suffix != "wav":  # libsndfile takes a cut WAV for a shorter one
        assert "is cut off" in caplog.text
    assert hear_file(matcher, path).locks


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"RIFF",
        b"not sound at all" * 100,
        b"\xff\xd8\xff\xe0" + bytes(500),
        b"fLaC" + b"x" * 99,
    ],
    ids=["zero length", "header", "text", "picture", "rubbish"],
)
def test_what_is_no_audio_is_refused_in_one_sentence(tmp_path, content):
    path = tmp_path / "sound.wav"
    path.write_bytes(content)
    with pytest.raises(PerceptionError, match=r"sound\.wav .* valid are \.wav") as caught:
        load_recording(path)
    assert str(caught.value).count("\n") == 0


@pytest.mark.parametrize(("rate", "samples"), [(4_000, 4_000), (44_100, 0)])
def test_a_file_without_usable_sound_is_refused(tmp_path, rate, samples):
    path = tmp_path / "sound.wav"
    soundfile.write(path, np.zeros(samples), rate)
    with pytest.raises(PerceptionError, match="no usable sound"):
        load_recording(path)


def test_a_clock_that_leaps_forward_loses_nothing_and_one_that_stands_hears_nothing_twice(
    matcher, music
):
    sound = music["piece0"]

    def make(clock, _bus):
        return FileSource(Recording("piece", sound, RATE), clock.utime())

    hall = Hall(matcher, make).run(3.0)
    for _ in range(5):
        hall.step()  # the same moment again
    hall.node.step(hall.clock.utime() - 1_000_000)  # and an earlier one
    hall.clock.advance_to(hall.clock.utime() + 10_000_000)
    hall.run(2.0)
    assert hall.locks[-1].track == "piece0"
    assert (hall.locks[-1].track_zero_utime - hall.begin) * 1e-6 == pytest.approx(0.0, abs=0.03)


def deliver(hall, card, sound, seconds, at):
    """Play a piece to the microphone for a while, in blocks of 10 ms; returns where it stands."""
    for number in range(round(seconds * 100)):
        hall.clock.advance_to(hall.clock.utime() + 10_000)
        if card.plugged:
            card.streams[-1].feed(sound[at : at + 160])
        at += 160
        if number % 5 == 4:
            hall.step()
    return at


def test_a_microphone_that_vanishes_and_returns_keeps_the_listener_alive(matcher, music):
    sound = soxr.resample(music["piece2"], RATE, 16_000)
    card = None

    def make(clock, _bus):
        nonlocal card
        card = FakePortAudio(clock, ("USB Audio", 1))
        return Microphone(clock, portaudio=card)

    hall = Hall(matcher, make)
    at = deliver(hall, card, sound, 4.0, 0)
    assert hall.locks and hall.locks[-1].track == "piece2"
    device = card.plugged.pop()
    card.streams[-1].active = False
    at = deliver(hall, card, sound, 6.0, at)
    last = hall.said["MUSIC_MATCH"][-1]
    assert last.lock == music_match_t.LOST and "is gone" in hall.node.detail
    assert hall.said["AUDIO_CLASS"][-1].label == audio_class_t.SKIP
    card.plugged.append(device)
    while hall.source.failure:
        at = deliver(hall, card, sound, 0.1, at)
        hall.source._worker and hall.source._worker.join()
    deliver(hall, card, sound, 4.0, at)
    assert hall.locks[-1].header.utime > hall.clock.utime() - 500_000
    assert (hall.locks[-1].track_zero_utime - hall.begin) * 1e-6 == pytest.approx(0.0, abs=0.05)
    states = [m.state for m in hall.said["AUDIO_SOURCE"]]
    source = audio_source_t
    assert states == [source.STARTED, source.FAILED, source.STARTED]


@pytest.mark.parametrize("audio", ["", "none.wav", "mic", "usb:1", "chunks:all", "show"])
def test_a_wrong_audio_lists_the_valid_forms_and_the_devices(tmp_path, audio):
    (tmp_path / "show").mkdir()
    bus = MemqHub().endpoint("listener", SimClock())
    with pytest.raises(PerceptionError) as caught:
        open_source(audio, tmp_path, bus, 0)
    sentence = str(caught.value)
    for part in (".flac", '"mic:"', '"mic:NAME"', "robot:INTERFACE", '"chunks:"', "this machine"):
        assert part in sentence


def test_every_form_of_audio_opens_its_source(tmp_path, piece):
    bus = MemqHub().endpoint("listener", SimClock())
    soundfile.write(tmp_path / "piece.ogg", piece, RATE)
    assert open_source("piece.ogg", tmp_path, bus, 5).first_sample_utime == 5
    assert open_source("chunks:", tmp_path, bus, 5).name == "chunks on AUDIO_CHUNK"
    robot = open_source("robot:lo", tmp_path, bus, 0)
    assert robot.name == "robot microphone on lo"
    robot.close()
    assert [is_live(a) for a in ("piece.ogg", "chunks:", "robot:lo", "mic:", "mic:x")] == [
        False, True, True, True, True,
    ]  # fmt: skip


def test_no_portaudio_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    bus = MemqHub().endpoint("listener", SimClock())
    with pytest.raises(PerceptionError, match="PortAudio is not usable here .*libportaudio2"):
        open_source("mic:", tmp_path, bus, 0)
    with pytest.raises(PerceptionError, match="no PortAudio and so no microphone"):
        open_source("none.wav", tmp_path, bus, 0)
