"""A stand-in for the module sounddevice: devices that come, go, stall and overflow on command."""

from types import SimpleNamespace

import numpy as np


class FakePortAudio:
    """As much of sounddevice as the microphone uses; time is the show's clock."""

    class PortAudioError(Exception):
        """What the real one raises."""

    def __init__(self, clock, *devices, rates=(16_000, 48_000)):
        self.clock = clock
        self.plugged = list(devices)
        self._known = list(devices)
        self.default = SimpleNamespace(device=[0, 0])
        self.rates = rates
        self.streams = []
        self.initialized = 1

    def query_devices(self):
        """List what was there when PortAudio started."""
        return [
            {"name": name, "max_input_channels": channels, "default_samplerate": 48_000.0}
            for name, channels in self._known
        ]

    def _terminate(self):
        if not self.initialized:
            raise self.PortAudioError("PortAudio not initialized")
        assert all(stream.is_closed for stream in self.streams), "a stream outlives PortAudio"
        self.initialized = 0

    def _initialize(self):
        self.initialized = 1
        self._known = list(self.plugged)

    def InputStream(self, **options):
        """Open a stream."""
        if options["samplerate"] not in self.rates:
            raise self.PortAudioError("Invalid sample rate")
        if options["channels"] > self._known[options["device"]][1]:
            raise self.PortAudioError("Invalid number of channels")
        if self._known[options["device"]] not in self.plugged:
            raise self.PortAudioError("Device unavailable")
        self.streams.append(FakeStream(self, **options))
        return self.streams[-1]


class FakeStream:
    """An opened device; `feed` plays the part of PortAudio's thread."""

    def __init__(self, card, samplerate, channels, callback, **_options):
        self.card, self.samplerate, self.channels = card, samplerate, channels
        self.callback = callback
        self.active = self.is_closed = False

    def start(self):
        self.active = True

    def abort(self, ignore_errors=True):
        self.active = False

    def close(self, ignore_errors=True):
        assert not self.is_closed, "closed twice: the real one would crash"
        self.is_closed = True

    @property
    def time(self):
        return 100.0 + self.card.clock.utime() * 1e-6 % 1e5

    def feed(self, samples, age_us=None, overflow=False):
        """Hand over (n,) samples whose first one sounded `age_us` ago; None: n samples ago."""
        if age_us is None:
            age_us = len(samples) * 1e6 / self.samplerate
        data = np.repeat(np.asarray(samples, np.float32)[:, None], self.channels, 1)
        when = SimpleNamespace(inputBufferAdcTime=self.time - age_us * 1e-6, currentTime=self.time)
        self.callback(data, len(samples), when, SimpleNamespace(input_overflow=overflow))
