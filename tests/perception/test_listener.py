"""The listener process: what it says on the bus, and when."""

import math

import numpy as np
import pytest
from synthetic_music import RATE

from downbeat.lcm_types import audio_class_t, audio_source_t, music_match_t
from downbeat.perception.listener import ListenerNode, level_dbfs
from downbeat.perception.router_energy import EnergyRouter
from downbeat.perception.source import FileSource, Recording
from downbeat.runtime.clock import SimClock
from downbeat.runtime.memq import MemqHub

LEAD_US = 1_000_000
CHANNELS = ("AUDIO_SOURCE", "AUDIO_CLASS", "MUSIC_MATCH")


def hear(matcher, samples, seconds, latency_s=0.0, next_boundary_s=None):
    """Return all messages by channel, and the payloads in order."""
    clock, hub = SimClock(), MemqHub()
    begin = clock.utime()
    payloads = []
    hub.tap(lambda utime, channel, payload: payloads.append((utime, channel, payload)))
    source = FileSource(Recording("show", samples, RATE), begin + LEAD_US, latency_s)
    node = ListenerNode(hub.endpoint("listener", clock), source, matcher, next_boundary_s)
    watcher = hub.endpoint("watcher", clock)
    watcher.subscribe(*CHANNELS)
    found = {channel: [] for channel in CHANNELS}
    for step in range(round((seconds + 1.5) * 1e6) // node.period_us):
        clock.advance_to(begin + step * node.period_us)
        node.step(clock.utime())
        watcher.pump()
        for channel in CHANNELS:
            found[channel] += [received.msg for received in watcher.take(channel)]
    return begin + LEAD_US, found, payloads


@pytest.fixture(scope="module")
def show(matcher, music):
    """Silence for 2 s, then piece1 from 3 s on for 6 s."""
    silence = np.zeros(2 * RATE, np.float32)
    sound = np.concatenate([silence, music["piece1"][3 * RATE : 9 * RATE]])
    return hear(matcher, sound, 8.0, next_boundary_s=lambda track, tau_s: tau_s + 5.0)


def test_source_says_when_it_starts_and_when_it_ends(show):
    first, found, _ = show
    states = [(m.state, m.first_sample_utime) for m in found["AUDIO_SOURCE"]]
    assert states == [(audio_source_t.STARTED, first), (audio_source_t.FINISHED, first)]
    assert found["AUDIO_SOURCE"][0].duration_s == pytest.approx(8.0)


def test_silence_is_skipped_and_music_is_not(show):
    first, found, _ = show
    for msg in found["AUDIO_CLASS"]:
        if msg.window_end_utime <= first + 2_000_000:
            assert msg.label == audio_class_t.SKIP
        else:
            assert msg.label == audio_class_t.MUSIC
        assert msg.window_start_utime < msg.window_end_utime
        assert math.isnan(msg.p_music)


def test_lock_carries_position_zero_time_and_boundary(show):
    first, found, _ = show
    locks = [m for m in found["MUSIC_MATCH"] if m.lock == music_match_t.LOCKED]
    windows = {m.header.utime: m for m in found["AUDIO_CLASS"]}
    assert locks and locks[0].header.utime - (first + 2_000_000) <= 1_750_000
    for msg in locks:
        window = windows[msg.header.utime]
        assert msg.track == "piece1" and msg.rate == 1.0
        start_s = (window.window_start_utime - first) * 1e-6 - 2.0 + 3.0
        assert msg.tau_s == pytest.approx(start_s, abs=0.03)
        assert (msg.track_zero_utime - first) * 1e-6 == pytest.approx(-1.0, abs=0.03)
        heard_s = (window.window_end_utime - msg.track_zero_utime) * 1e-6
        assert msg.next_boundary_s == pytest.approx(heard_s + 5.0, abs=0.03)


def test_nothing_locks_before_the_music(show):
    first, found, _ = show
    for msg in found["MUSIC_MATCH"]:
        if msg.header.utime <= first + 2_500_000:
            assert msg.lock == music_match_t.LOST


def test_two_runs_say_the_same_bytes(matcher, music):
    sound = music["piece0"][: 3 * RATE]
    _, _, once = hear(matcher, sound, 3.0)
    _, _, twice = hear(matcher, sound, 3.0)
    assert once == twice


def test_latency_delays_the_news_but_not_the_stamps(matcher, music):
    sound = music["piece0"][RATE : 6 * RATE]
    first, prompt, _ = hear(matcher, sound, 5.0)
    _, late, _ = hear(matcher, sound, 5.0, latency_s=0.5)
    zeros = [
        [m.track_zero_utime for m in found["MUSIC_MATCH"] if m.lock == music_match_t.LOCKED]
        for found in (prompt, late)
    ]
    assert zeros[0] and zeros[1]
    for zero in zeros[0] + zeros[1]:
        assert (zero - first) * 1e-6 == pytest.approx(-1.0, abs=0.03)
    begins = [found["MUSIC_MATCH"][0].header.utime for found in (prompt, late)]
    assert begins[1] - begins[0] == pytest.approx(500_000, abs=50_000)


def test_a_bad_sample_breaks_nothing(matcher, music):
    sound = music["piece0"][: 4 * RATE].copy()
    sound[2 * RATE] = np.nan
    _, found, _ = hear(matcher, sound, 4.0)
    assert found["AUDIO_SOURCE"][-1].state == audio_source_t.FINISHED


def test_router_decides_by_level():
    wave = np.where(np.arange(16_000) % 2, 1.0, -1.0).astype(np.float32)
    for level, label in ((0.1, audio_class_t.MUSIC), (1e-5, audio_class_t.SKIP)):
        router = EnergyRouter()
        router.hear(level * wave, 0)
        assert router.judge(0.0).label == label
    assert level_dbfs(np.zeros(0, np.float32)) == -120.0
