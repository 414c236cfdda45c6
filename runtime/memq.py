"""A bus inside one process, for lockstep: ordered, deterministic, and still through the codec.

Like LCM's own memq provider, with what a lockstep scheduler needs on top: several named endpoints,
a tap for the log, and the show's simulated time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from hashlib import blake2b

from downbeat.runtime.bus_types import BusError
from downbeat.runtime.clock import Clock
from downbeat.runtime.endpoint import Endpoint
from downbeat.runtime.traffic import Impairer

Tap = Callable[[int, str, bytes], None]
"""Called with (utime, channel, payload) for every message published."""


class MemqHub:
    """Connects endpoints; messages arrive in the order of publication."""

    def __init__(self, seed: int = 0) -> None:
        """Make a hub; epochs of its endpoints follow from `seed` and the process names."""
        self._seed = seed
        self._endpoints: list[MemqEndpoint] = []
        self._taps: list[Tap] = []
        self._impairer: Impairer | None = None

    def endpoint(self, process: str, clock: Clock) -> MemqEndpoint:
        """Add the endpoint of one process.

        Raises:
            BusError: The process has one already.
        """
        if any(endpoint.process == process for endpoint in self._endpoints):
            raise BusError(f"Process {process!r} has an endpoint on this hub already.")
        digest = blake2b(f"{self._seed}/{process}".encode(), digest_size=8).digest()
        epoch = int.from_bytes(digest, "big") >> 1
        endpoint = MemqEndpoint(self, clock, process, epoch)
        self._endpoints.append(endpoint)
        return endpoint

    def tap(self, listener: Tap) -> None:
        """See every message, as published, from now on."""
        self._taps.append(listener)

    def impair(self, impairer: Impairer) -> None:
        """Put a bad network between publishers and subscribers; taps still see the good one."""
        self._impairer = impairer

    def deliver(self, utime: int, channel: str, payload: bytes) -> None:
        """Hand a payload to every subscriber, in the order of the endpoints' creation."""
        for tap in self._taps:
            tap(utime, channel, payload)
        if self._impairer is not None:
            self._impairer.feed(utime, channel, payload)
            self.release(utime)
            return
        for endpoint in self._endpoints:
            endpoint.offer(channel, payload)

    def release(self, utime: int) -> None:
        """Hand over what the bad network has carried so far."""
        if self._impairer is None:
            return
        for channel, payload in self._impairer.take(utime):
            for endpoint in self._endpoints:
                endpoint.offer(channel, payload)

    def remove(self, endpoint: MemqEndpoint) -> None:
        """Take an endpoint off the hub."""
        if endpoint in self._endpoints:
            self._endpoints.remove(endpoint)


class MemqEndpoint(Endpoint):
    """One process's end of the hub."""

    def __init__(self, hub: MemqHub, clock: Clock, process: str, epoch: int) -> None:
        super().__init__(clock, process, epoch)
        self._hub = hub
        self._arrived: deque[tuple[str, bytes]] = deque()

    def _send(self, channel: str, payload: bytes) -> None:
        self._hub.deliver(self.clock.utime(), channel, payload)

    def offer(self, channel: str, payload: bytes) -> None:
        """Queue a payload if the channel is subscribed to."""
        if channel in self._subscriptions:
            self._arrived.append((channel, payload))

    def pump(self, timeout_s: float = 0.0) -> int:
        """Take everything that has arrived; never waits, since nobody else runs meanwhile."""
        self._hub.release(self.clock.utime())
        arrived = self._arrived
        count = len(arrived)
        for _ in range(count):
            channel, payload = arrived.popleft()
            self._receive(channel, payload)
        return count

    def close(self) -> None:
        """Leave the hub."""
        self._hub.remove(self)
