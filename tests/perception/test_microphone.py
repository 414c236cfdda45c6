"""A microphone on this machine: stamps, losses, and a device that goes and comes back."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from fake_portaudio import FakePortAudio

from downbeat.perception.capture_clock import JUMP_US, CaptureClock
from downbeat.perception.errors import PerceptionError
from downbeat.perception.microphone import QUEUE_BLOCKS, Microphone
from downbeat.perception.ring import Ring
from downbeat.perception.sound_devices import find_input, input_devices
from downbeat.runtime.clock import SimClock

BLOCK_S = 0.01
BUILT_IN, USB = ("HDA Intel: ALC257 Analog", 2), ("USB Audio: Blue Yeti", 2)
SPEAKER = ("HDMI 0", 0)


class Stage:
    """A clock, a fake card, a microphone and the ring that it fills."""

    def __init__(self, device="", rates=(16_000, 48_000), devices=(BUILT_IN, USB, SPEAKER)):
        self.clock = SimClock()
        self.card = FakePortAudio(self.clock, *devices, rates=rates)
        self.microphone = Microphone(self.clock, device, portaudio=self.card)
        self.ring = Ring(6.0)
        self.sent = 0
        self.blocks = []

    @property
    def stream(self):
        return self.card.streams[-1]

    def hear(self, seconds, signal=None, step_s=0.05, **feed):
        """Let the card deliver for a while, and read at every step."""
        rate = self.stream.samplerate
        count = round(rate * BLOCK_S)
        for number in range(round(seconds / BLOCK_S)):
            self.clock.advance_to(self.clock.utime() + round(BLOCK_S * 1e6))
            n = self.sent + np.arange(count)
            self.stream.feed(np.sin(n * 0.1) * 0.1 if signal is None else signal(n), **feed)
            self.sent += count
            if (number + 1) % round(step_s / BLOCK_S) == 0:
                self.read()

    def read(self):
        found = self.microphone.read(self.clock.utime())
        for block in found:
            self.ring.append(block.samples, block.utime, block.follows)
        self.blocks += found
        return found

    def wait(self, seconds, until=lambda: False):
        """Let time pass without sound."""
        end = self.clock.utime() + round(seconds * 1e6)
        while self.clock.utime() < end and not until():
            self.clock.advance_to(self.clock.utime() + 50_000)
            self.read()
            time.sleep(0.002)  # the worker is a real thread


@pytest.mark.parametrize("rates", [(16_000, 48_000), (48_000,)])
def test_an_impulse_in_front_of_the_microphone_has_its_time(rates):
    stage = Stage(rates=rates)
    begin = stage.clock.utime()
    at = rates[0] // 2 + 123
    stage.hear(1.5, lambda n: (n == at).astype(np.float32))
    assert stage.stream.samplerate == rates[0] and stage.ring.num_gaps == 0
    sound = stage.ring.last(6.0)
    first = stage.ring.last_utime - len(sound) * 62.5
    heard = first + int(np.abs(sound).argmax()) * 62.5
    assert heard == pytest.approx(begin + at * 1e6 / rates[0], abs=64)


def test_a_loop_that_reads_rarely_hears_the_same():
    often, rarely = Stage(), Stage()
    often.hear(2.0)
    rarely.hear(2.0, step_s=1.0)
    assert np.array_equal(often.ring.last(6.0), rarely.ring.last(6.0))
    assert often.ring.last_utime == rarely.ring.last_utime


def test_an_overflow_is_counted_and_is_a_gap():
    stage = Stage()
    stage.hear(1.0)
    stage.clock.advance_to(stage.clock.utime() + 7_000)
    stage.hear(0.05, overflow=False)  # 7 ms late and nobody said that anything was lost: jitter
    assert stage.ring.num_gaps == 0
    stage.clock.advance_to(stage.clock.utime() + 5_000)
    stage.stream.feed(np.zeros(160), overflow=True)
    stage.read()
    counters = stage.microphone.counters
    assert counters.xruns == 1 and stage.ring.num_gaps == 1
    assert stage.ring.seconds == pytest.approx(0.01)
    assert counters.lost_samples > 0 and "xruns 1" in counters.text()


def test_samples_that_the_driver_silently_lost_are_a_gap_too():
    stage = Stage()
    stage.hear(1.0)
    stage.clock.advance_to(stage.clock.utime() + 200_000)
    stage.hear(0.5)
    assert stage.ring.num_gaps == 1 and stage.ring.seconds == pytest.approx(0.5)
    assert stage.microphone.counters.lost_samples == pytest.approx(3_200, abs=160)
    assert stage.ring.last_utime == pytest.approx(stage.clock.utime(), abs=1_000)


@pytest.mark.parametrize("too_long_s", [BLOCK_S, 2.0])
def test_a_loop_that_stands_still_for_too_long_loses_sound_and_says_so(too_long_s):
    stage = Stage()
    stage.hear(1.0)
    seconds = QUEUE_BLOCKS * BLOCK_S + too_long_s
    stage.hear(seconds, step_s=seconds)
    stage.hear(0.5)
    assert stage.ring.num_gaps == 1 and stage.ring.seconds == pytest.approx(0.5)
    lost = round(16_000 * too_long_s)
    assert stage.microphone.counters.lost_samples == pytest.approx(lost, abs=200)


def test_a_driver_that_knows_no_time_is_stamped_by_the_arrival():
    stage = Stage()
    stage.hear(1.0, age_us=1e12)
    assert stage.ring.num_gaps == 0
    assert stage.ring.last_utime == pytest.approx(stage.clock.utime(), abs=1_000)


def test_samples_that_are_no_numbers_are_silence_and_counted():
    stage = Stage()
    stage.hear(0.5, lambda n: np.where(n % 100, 0.1, np.nan))
    stage.hear(0.5, lambda n: np.where(n % 100, 0.1, -np.inf))
    assert stage.microphone.counters.bad_samples == 160
    assert np.isfinite(stage.ring.last(6.0)).all() and stage.ring.seconds == 1.0


@pytest.mark.parametrize("how", ["unplugged", "stalled"])
def test_a_microphone_that_vanishes_is_heard_again_when_it_returns(how):
    stage = Stage("yeti")
    stage.hear(1.0)
    stage.card.plugged.remove(USB)
    stage.stream.active = how == "stalled"
    stage.wait(2.5)
    failure = stage.microphone.failure
    assert "Blue Yeti is gone" in failure and stage.microphone.counters.outages == 1
    assert stage.microphone.heard_utime == stage.clock.utime()
    stage.wait(3.0)
    assert stage.microphone.failure == failure and stage.microphone.counters.outages == 1
    assert len(stage.card.streams) == 1
    stage.card.plugged.insert(0, USB)  # and has another number than before
    stage.wait(3.0, until=lambda: not stage.microphone.failure)
    assert not stage.microphone.failure and len(stage.card.streams) == 2
    stage.hear(1.0)
    assert stage.ring.num_gaps == 1 and stage.ring.seconds == pytest.approx(1.0)
    assert stage.ring.last_utime == pytest.approx(stage.clock.utime(), abs=1_000)
    stage.microphone.close()
    assert all(stream.is_closed for stream in stage.card.streams)


def test_a_portaudio_that_does_not_start_again_is_tried_again():
    stage = Stage("yeti")
    stage.hear(0.5)
    stage.stream.active = False
    attempts = []
    start = stage.card._initialize

    def refuse_twice():
        attempts.append(1)
        if len(attempts) < 3:
            raise stage.card.PortAudioError("host error")
        start()

    stage.card._initialize = refuse_twice
    stage.wait(6.0, until=lambda: not stage.microphone.failure and len(attempts) > 0)
    assert len(attempts) == 3 and not stage.microphone.failure


def test_a_device_that_takes_only_its_own_format_is_opened_with_that():
    class StereoOnly(FakePortAudio):
        def InputStream(self, **options):
            if options["channels"] != 2:
                raise self.PortAudioError("Invalid number of channels")
            return super().InputStream(**options)

    clock = SimClock()
    card = StereoOnly(clock, USB, rates=(48_000,))
    microphone = Microphone(clock, portaudio=card)
    assert card.streams[0].samplerate == 48_000 and card.streams[0].channels == 2
    assert microphone.sample_rate_hz == 16_000
    card.rates = ()
    with pytest.raises(PerceptionError, match="cannot be opened at 16000 or 48000 Hz"):
        Microphone(clock, portaudio=card)


@pytest.mark.parametrize(
    ("wanted", "found"),
    [("", "HDA Intel: ALC257 Analog"), ("yeti", "USB Audio: Blue Yeti"), ("0", BUILT_IN[0])],
)
def test_a_device_is_found_by_name_part_of_it_number_or_default(wanted, found):
    card = FakePortAudio(SimClock(), BUILT_IN, USB, SPEAKER)
    assert find_input(card, wanted).name == found
    assert [d.name for d in input_devices(card)] == [BUILT_IN[0], USB[0]]


@pytest.mark.parametrize(
    ("wanted", "sentence"),
    [
        ("nonesuch", 'is not there; this machine has 0 "HDA Intel: ALC257 Analog", 1 "USB Audio'),
        ("audio", "may be any of 2"),
        ("HDMI", "is not there"),
    ],
)
def test_a_wrong_name_is_refused_with_the_devices_there_are(wanted, sentence):
    card = FakePortAudio(SimClock(), BUILT_IN, USB, SPEAKER, ("Other audio", 1))
    with pytest.raises(PerceptionError, match=sentence):
        find_input(card, wanted)


def test_a_machine_without_a_microphone_says_so():
    with pytest.raises(PerceptionError, match="this machine has none at all"):
        Microphone(SimClock(), portaudio=FakePortAudio(SimClock(), SPEAKER))


def test_a_card_whose_crystal_runs_differently_is_followed_through_jitter():
    rng = np.random.default_rng(0)
    clock, errors, true_us = CaptureClock(16_000), [], 1e15
    for number in range(30_000):  # 5 min
        jitter = abs(float(rng.normal(0.0, 1_000.0)))
        start, follows = clock.place(160, round(true_us + jitter), False)
        assert follows or number == 0
        errors.append(start - true_us)
        true_us += 10_000 * (1.0 + 150e-6)
    late = np.array(errors[2_000:])
    assert abs(clock.skew - 150e-6) < 20e-6
    assert np.abs(late - late.mean()).max() < 200 and 0 < late.mean() < 1_500
    assert clock.num_lost == 0


def test_time_that_jumps_is_a_gap_once():
    for jump_us in (JUMP_US + 20_000, -5_000_000, 3_600_000_000):
        clock, base = CaptureClock(16_000), 10_000_000_000
        for number in range(10):
            clock.place(160, base + number * 10_000, False)
        placed = [clock.place(160, base + 100_000 + jump_us + n * 10_000, False) for n in range(9)]
        assert [follows for _, follows in placed] == [False] + [True] * 8
        assert placed[0][0] == base + 100_000 + jump_us


REAL = """
import sys, time
import numpy as np
from downbeat.perception.microphone import Microphone
from downbeat.runtime.clock import WallClock

clock = WallClock()
microphone = Microphone(clock, "notamic")

def hear(seconds):
    blocks, end = [], time.monotonic() + seconds
    while not blocks and time.monotonic() < end:
        time.sleep(0.05)
        blocks = microphone.read(clock.utime())
    return blocks

blocks = hear(10.0)
assert blocks and all(np.isfinite(block.samples).all() for block in blocks)
microphone._capture._stream.abort()  # as a device that stops by itself
microphone.read(clock.utime())
assert "notamic is gone" in microphone.failure, microphone.failure
assert hear(10.0) and not microphone.failure and microphone.counters.outages == 1
microphone.close()
print(microphone.name)
"""


@pytest.mark.slow
def test_the_real_portaudio_opens_delivers_and_opens_again(tmp_path):
    """On ALSA's null device, which needs no hardware, and has no pace either."""
    pytest.importorskip("sounddevice", exc_type=(ImportError, OSError))
    base = Path("/usr/share/alsa/alsa.conf")
    if not base.exists():
        pytest.skip("ALSA is not installed")
    config = tmp_path / "asound.conf"
    config.write_text(f"<{base}>\npcm.notamic {{ type null hint {{ show on description x }} }}\n")
    done = subprocess.run(
        [sys.executable, "-c", REAL],
        env={**os.environ, "ALSA_CONFIG_PATH": str(config)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "microphone notamic"
