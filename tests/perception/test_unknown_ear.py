"""The listener on music that nobody knows: the beat, what it resembles, and where it is silent."""

import numpy as np
import pytest
from synthetic_music import RATE, make_music

from downbeat.lcm_types import music_beat_t, music_match_t
from downbeat.perception.beat_follower import BeatFollower
from downbeat.perception.chunk_tracker import ChunkTracker
from downbeat.perception.hearing_config import HearingConfig
from downbeat.perception.likeness import Similar
from downbeat.perception.listener import ListenerNode
from downbeat.perception.section_finder import Change
from downbeat.perception.source import FileSource, Recording
from downbeat.perception.unknown_ear import UnknownEar
from downbeat.runtime.clock import SimClock
from downbeat.runtime.config import ConfigError, config_from
from downbeat.runtime.memq import MemqHub

CHANNELS = ("MUSIC_MATCH", "MUSIC_BEAT")


class Alike:
    """A likeness that always says the same, and counts how often it is asked."""

    name = "alike"

    def __init__(self):
        self.asked = 0

    def nearest(self, samples, sample_rate_hz):
        self.asked += 1
        return Similar("piece2", 0.7, 0.2, "piece0")


class Turns:
    """A finder that tells one change when it has heard 5 s, and counts how often it began anew."""

    def __init__(self):
        self.heard, self.resets = 0, 0

    def hear(self, samples, first_utime):
        before, self.heard = self.heard, self.heard + len(samples)
        return Change(first_utime, 1.5) if before < 80_000 <= self.heard else None

    def reset(self):
        self.resets += 1


def drums(bpm, seconds):
    """Drums at a tempo, first beat at 0 s."""
    rng = np.random.default_rng(4)
    t = np.arange(round(seconds * RATE)) / RATE
    since = t % (60.0 / bpm)
    sound = 0.3 * np.exp(-since * 30.0) * np.sin(2 * np.pi * 70.0 * t)
    sound += 0.3 * np.exp(-since * 150.0) * rng.standard_normal(len(t))
    backbeat = (t + 60.0 / bpm) % (120.0 / bpm)
    sound += 0.2 * np.exp(-backbeat * 25.0) * rng.standard_normal(len(t))
    hats = 0.1 * np.exp(-(t % (30.0 / bpm)) * 60.0) * rng.standard_normal(len(t))
    return (sound + hats + 0.001 * rng.standard_normal(len(t))).astype(np.float32)


def hear(matcher, samples, seconds, unknown, tracker=None):
    """Return the time of sample 0 and all messages by channel."""
    clock, hub = SimClock(), MemqHub()
    begin = clock.utime()
    source = FileSource(Recording("show", samples, RATE), begin)
    bus = hub.endpoint("listener", clock)
    node = ListenerNode(bus, source, matcher, unknown=unknown, tracker=tracker)
    watcher = hub.endpoint("watcher", clock)
    watcher.subscribe(*CHANNELS)
    found = {channel: [] for channel in CHANNELS}
    for step in range(round(seconds * 1e6) // node.period_us):
        clock.advance_to(begin + step * node.period_us)
        node.step(clock.utime())
        watcher.pump()
        for channel in CHANNELS:
            found[channel] += [received.msg for received in watcher.take(channel)]
    return begin, found


@pytest.fixture(scope="module")
def drumming(matcher):
    ears = UnknownEar(BeatFollower(), Turns(), Alike())
    return hear(matcher, drums(126.0, 14.0), 13.5, ears)


def test_the_beat_of_unknown_music_is_published_as_it_sounds(drumming):
    begin, found = drumming
    followed = [m for m in found["MUSIC_BEAT"] if m.state == music_beat_t.FOLLOWING]
    assert followed
    assert followed[0].header.utime - begin < 8_000_000
    for msg in followed[-8:]:
        assert msg.period_s == pytest.approx(60.0 / 126.0, abs=0.003)
        beats = (msg.beat_utime - begin) * 1e-6 * 126.0 / 60.0
        assert abs(beats - round(beats)) * 60.0 / 126.0 < 0.03
        assert abs(msg.beat_utime - msg.header.utime) < 1_000_000


def test_what_it_resembles_is_told_once_a_second_and_locks_nothing(drumming):
    _, found = drumming
    alike = [m for m in found["MUSIC_MATCH"] if m.method == music_match_t.EMBEDDING]
    assert 10 <= len(alike) <= 14
    assert {(m.track, m.runner_up, m.lock, m.accepted) for m in alike} == {
        ("piece2", "piece0", music_match_t.LOST, False)
    }


def test_a_change_is_told_with_the_time_at_which_it_sounded(drumming):
    begin, found = drumming
    before = [m for m in found["MUSIC_BEAT"] if m.header.utime < begin + 4_900_000]
    after = [m for m in found["MUSIC_BEAT"] if m.header.utime > begin + 5_300_000]
    assert {m.section_utime for m in before} == {0}
    (told,) = {m.section_utime for m in after}
    assert abs(told - begin - 5_000_000) <= 50_000


def test_a_known_track_is_neither_compared_nor_searched_for_changes(matcher, music):
    alike, turns = Alike(), Turns()
    hear(matcher, music["piece1"][: 8 * RATE], 8.0, UnknownEar(BeatFollower(), turns, alike))
    assert alike.asked <= 3  # before the lock
    assert turns.resets > 50


def test_silence_has_no_beat(matcher):
    _, found = hear(matcher, np.zeros(4 * RATE, np.float32), 4.0, UnknownEar(BeatFollower()))
    assert {m.state for m in found["MUSIC_BEAT"]} == {music_beat_t.NONE}
    assert found["MUSIC_MATCH"] == []


def test_the_papers_listening_judges_each_chunk_alone(matcher, music):
    sound = np.concatenate([music["piece0"][: 10 * RATE], make_music(99, 10.0)])
    alike = Alike()
    ears = UnknownEar(BeatFollower(), None, alike)
    _, found = hear(matcher, sound, 20.5, ears, ChunkTracker(matcher))
    chunks = [m for m in found["MUSIC_MATCH"] if m.method == music_match_t.FINGERPRINT]
    assert [(m.track, m.lock) for m in chunks] == [("piece0", music_match_t.CANDIDATE)] * 2
    assert [m.accepted for m in chunks] == [True, True]
    assert chunks[0].tau_s == pytest.approx(0.0, abs=0.1)
    assert chunks[1].tau_s == pytest.approx(5.0, abs=0.1)
    assert alike.asked == 2  # the two chunks that nothing matched


def test_hearing_toml_says_what_does_not_go_together():
    with pytest.raises(ConfigError, match=r"router is not valid.*models export ast"):
        config_from({"router": {"backend": "ast"}}, HearingConfig, "hearing.toml")
    with pytest.raises(ConfigError, match=r"likeness is not valid.*models export clap"):
        config_from({"likeness": {"model": "clap"}}, HearingConfig, "hearing.toml")
    with pytest.raises(ConfigError, match=r"constellation.*conductor.mode = 'chunks'"):
        config_from({"matcher": "constellation"}, HearingConfig, "hearing.toml")
    chunks = {"matcher": "constellation", "conductor": {"mode": "chunks"}}
    assert config_from(chunks, HearingConfig, "hearing.toml").matcher == "constellation"
    with pytest.raises(ConfigError, match=r"hearing.toml:matcher is 'shazam'"):
        config_from({"matcher": "shazam"}, HearingConfig, "hearing.toml")
