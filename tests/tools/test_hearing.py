"""`downbeat listen` and `downbeat source` by themselves, as processes over real LCM."""

import subprocess
import sys
import time

import numpy as np
import pytest
import soundfile

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.tracks import Track
from downbeat.lcm_types import audio_class_t, audio_source_t, music_beat_t, music_match_t
from downbeat.perception.errors import PerceptionError
from downbeat.perception.matcher import AlignmentMatcher
from downbeat.runtime.bus import open_udpm
from downbeat.runtime.clock import SimClock, WallClock
from downbeat.runtime.memq import MemqHub
from downbeat.tools.hearing import Narrator, run_source
from downbeat.tools.recordings import INDEX_NAME, write_track
from downbeat.tools.show import SHOW_NAME, ShowConfig

RATE = 16_000


def piece(seed, seconds):
    """Notes that change four times a second, with harmonics."""
    rng = np.random.default_rng(seed)
    parts = []
    for _ in range(round(seconds * 4)):
        t = np.arange(RATE // 4) / RATE
        hertz = 110.0 * 2 ** (rng.integers(0, 36, 3) / 12)
        tone = sum(np.sin(2 * np.pi * h * k * t) / k for h in hertz for k in range(1, 6))
        parts.append(0.05 * tone * np.exp(-3 * t))
    return np.concatenate(parts).astype(np.float32)


@pytest.fixture
def url(free_url):
    return free_url


@pytest.fixture
def show(tmp_path):
    """A show whose listener hears five seconds of one of two pieces, from 2 s on."""
    matcher, catalog = AlignmentMatcher(), tmp_path / "catalog"
    catalog.mkdir()
    for name, seed in (("one", 1), ("two", 2)):
        sound = piece(seed, 20.0)
        matcher.add(name, sound, RATE)
        track = Track(name, "kpop", BeatGrid(120.0), duration_s=20.0)
        write_track(catalog / f"{name}.toml", track)
        if name == "two":
            soundfile.write(tmp_path / "sound.wav", sound[2 * RATE : 7 * RATE], RATE)
    matcher.save(catalog / INDEX_NAME)

    def write(audio):
        config = ShowConfig(audio=audio, tracks="catalog", index=f"catalog/{INDEX_NAME}")
        (tmp_path / SHOW_NAME).write_text(config.to_toml(), encoding="utf-8")
        return tmp_path / SHOW_NAME

    return write


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "downbeat.tools.cli", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.mark.slow
def test_listen_by_itself_hears_a_file_tells_what_it_is_and_ends(show, url):
    listener = start("listen", "--show", show("sound.wav"), "--url", url)
    told, _ = listener.communicate(timeout=60)
    assert listener.returncode == 0, told
    assert "hears sound" in told and "has heard all of sound" in told
    locked = next(line for line in told.splitlines() if "locked on two" in line)
    time_s, place_s = float(locked.split()[0]), float(locked.split()[-2])
    assert place_s == pytest.approx(time_s + 2.0, abs=0.1)


@pytest.mark.slow
def test_a_source_in_another_process_is_heard_over_chunks(show, url, tmp_path):
    listener = start("listen", "--show", show("chunks:"), "--url", url)
    clock = WallClock()
    bus = open_udpm(url, clock, "operator")
    bus.subscribe("AUDIO_SOURCE", "MUSIC_MATCH")
    end = time.monotonic() + 60
    while bus.latest("AUDIO_SOURCE") is None and listener.poll() is None:
        bus.pump(0.1)
    source = start("source", tmp_path / "sound.wav", "--url", url)
    locks = []
    while not locks and time.monotonic() < end and listener.poll() is None:
        bus.pump(0.1)
        found = [received.msg for received in bus.take("MUSIC_MATCH")]
        locks = [msg for msg in found if msg.lock == music_match_t.LOCKED]
    told, _ = source.communicate(timeout=60)
    assert source.returncode == 0, told
    listener.terminate()
    told, _ = listener.communicate(timeout=60)
    assert locks and locks[0].track == "two", told
    assert "hears chunks on AUDIO_CHUNK" in told and "locked on two" in told


@pytest.mark.slow
def test_listen_with_a_microphone_that_is_not_there_is_one_sentence(show, url):
    listener = start("listen", "--show", show("mic:nonesuch"), "--url", url)
    told, _ = listener.communicate(timeout=60)
    assert listener.returncode == 2
    assert "icrophone" in told
    assert told.startswith("downbeat: ") and told.count("\n") == 1 and "Traceback" not in told


def test_a_narrator_tells_changes_and_nothing_else():
    lines = []
    narrator = Narrator(lines.append)
    clock = SimClock()
    bus = MemqHub().endpoint("listener", clock)
    bus.tap = narrator
    begin = clock.utime()
    source, heard, match = audio_source_t(), audio_class_t(), music_match_t()
    source.state, source.name, source.first_sample_utime = source.STARTED, "piece", begin
    source.header.utime = begin
    bus.publish("AUDIO_SOURCE", source)
    heard.model, heard.rms_dbfs, match.track = "energy", -20.0, "two"
    match.rate, match.lock, match.track_zero_utime = 1.0, match.LOCKED, begin - 2_000_000
    for hop in range(1, 5):
        utime = begin + hop * 250_000
        heard.header.utime = match.header.utime = heard.window_end_utime = utime
        heard.label = heard.MUSIC if hop > 1 else heard.SKIP
        bus.publish("AUDIO_CLASS", heard)
        if hop > 2:
            bus.publish("MUSIC_MATCH", match)
    match.track_zero_utime -= 10_000_000
    bus.publish("MUSIC_MATCH", match)
    source.state = source.FINISHED
    bus.publish("AUDIO_SOURCE", source)
    assert [line.split("  ")[-1] for line in lines] == [
        "hears piece",
        "nothing, -20 dB",
        "music, -20 dB",
        "locked on two at 2.75 s",
        "locked on two at 13.00 s",
        "has heard all of piece",
    ]
    assert narrator.is_finished


def test_a_source_does_not_send_what_it_receives():
    with pytest.raises(PerceptionError, match="would send what it receives"):
        run_source("chunks:", "")


def test_unknown_music_is_told_by_its_beat_its_changes_and_what_it_is_like():
    lines = []
    narrator = Narrator(lines.append)
    alike = music_match_t()
    alike.header.utime, alike.method, alike.track = 6_000_000, music_match_t.EMBEDDING, "one"
    alike.rate = 1.0
    alike.tau_std_s = alike.next_boundary_s = float("nan")
    beat = music_beat_t()
    beat.header.utime, beat.state = 7_000_000, music_beat_t.FOLLOWING
    beat.period_s, beat.section_utime = 0.5, 5_500_000
    for _ in range(3):
        narrator("MUSIC_MATCH", alike.encode())
        narrator("MUSIC_BEAT", beat.encode())
    assert [line.split("s  ")[1] for line in lines] == [
        "unknown, most like one",
        "beat at 120.0 BPM",
        "the music changed at 5.50 s",
    ]
