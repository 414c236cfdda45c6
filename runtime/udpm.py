"""The real bus: LCM over UDP multicast, every process its own endpoint."""

from __future__ import annotations

import errno
import ipaddress
import logging
import secrets
import socket
import time
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import parse_qsl, urlencode

import lcm

from downbeat.lcm_types.channels import CHANNELS, Channel
from downbeat.runtime import channel_filter
from downbeat.runtime.bus_types import BusError
from downbeat.runtime.clock import Clock
from downbeat.runtime.endpoint import Endpoint

log = logging.getLogger("downbeat.bus")

DEFAULT_URL = "udpm://239.255.76.67:7667?ttl=0"
"""LCM's default group, kept on this machine, so that a plain lcm-spy sees a show."""
RECV_BUF_SIZE = 4_194_304
"""[bytes] Holds 20 000 state messages while a process sleeps; the default holds 300."""
MAX_PER_PUMP = 20_000
"""A flood must not keep a process from its tick."""
AUDIO_PORT_OFFSET = 1
"""Bulk audio has a group of its own, so that a network spares those who do not listen, and a port
of its own, for Linux hands a port's traffic to all groups joined on it. The group is the neighbour
of the main one: one route of two addresses (/31) carries both."""


class MulticastError(BusError):
    """This machine does not carry multicast; the message says which command changes that."""


@dataclass(frozen=True, slots=True)
class UdpmUrl:
    """A parsed `udpm://group:port?key=value` URL.

    Attributes:
        group: Multicast address.
        port: UDP port.
        options: Keys and values after the question mark.
    """

    group: str
    port: int
    options: dict[str, str]

    @property
    def ttl(self) -> int:
        """Hops; 0 keeps everything on this machine."""
        return int(self.options.get("ttl", "0"))

    def text(self) -> str:
        """Return the URL with our buffer size, and ttl=0 unless it says otherwise."""
        options = {"ttl": "0", "recv_buf_size": str(RECV_BUF_SIZE), **self.options}
        return f"udpm://{self.group}:{self.port}?{urlencode(options)}"

    @property
    def audio(self) -> UdpmUrl:
        """Where bulk audio travels."""
        group = str(ipaddress.IPv4Address(int(ipaddress.IPv4Address(self.group)) ^ 1))
        return replace(self, group=group, port=self.port + AUDIO_PORT_OFFSET)

    @property
    def both_groups(self) -> str:
        """The main group and the one of audio as a network, for a route."""
        return f"{min(self.group, self.audio.group, key=ipaddress.IPv4Address)}/31"


def parse_udpm_url(url: str) -> UdpmUrl:
    """Parse an LCM URL; empty stands for LCM's default group with ttl=0.

    Raises:
        BusError: Not a udpm URL with a multicast group and a port.
    """
    text = url or DEFAULT_URL
    scheme, _, rest = text.partition("://")
    address, _, query = rest.partition("?")
    group, _, port = address.partition(":")
    try:
        is_group = ipaddress.IPv4Address(group).is_multicast
        number = int(port or "7667")
        options = dict(parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query)))
        is_valid = is_group and 0 < number < 65535 and int(options.get("ttl", "0")) >= 0
    except ValueError:
        is_valid = False
    if scheme != "udpm" or not is_valid:
        raise BusError(f"{url!r} is not an LCM multicast URL; valid is e.g. {DEFAULT_URL!r}.")
    return UdpmUrl(group, number, options)


def check_multicast(url: UdpmUrl) -> None:
    """Ask the kernel for a route to the group.

    Raises:
        MulticastError: There is none.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((url.group, url.port))
        except OSError as error:
            raise _multicast_error(url, str(error)) from error


def _multicast_error(url: UdpmUrl, reason: str) -> MulticastError:
    return MulticastError(
        f"LCM cannot use {url.text()}: {reason}. Give the group a route, as root: "
        f"`ip link set lo up && ip route add {url.both_groups} dev lo`; "
        "`downbeat demo --lockstep` works without."
    )


def drain(link: Any, timeout_ms: int = 0) -> int:
    """Run the handlers of everything that has arrived on an `lcm.LCM`; never raises.

    Args:
        link: The connection.
        timeout_ms: How long to wait for the first message.

    Returns:
        Messages handled.
    """
    count = 0
    try:
        if timeout_ms:
            if not link.handle_timeout(timeout_ms):
                return 0
            count = 1
        while count < MAX_PER_PUMP and link.handle_timeout(0):
            count += 1
    except OSError as error:
        if error.errno != errno.EINTR:
            log.error("receiving failed: %s", error)
    return count


class UdpmBus(Endpoint):
    """One process's LCM endpoint."""

    def __init__(self, url: UdpmUrl, clock: Clock, process: str) -> None:
        super().__init__(clock, process, epoch=secrets.randbits(62))
        self._url = url
        self._before: dict[str, set[int]] = {}
        self._sockets: dict[str, int | None] = {}
        self._joined: dict[str, list[str]] = {}
        self._links: dict[str, Any] = {"main": self._connect("main")}

    def _url_of(self, group: str) -> UdpmUrl:
        return self._url if group == "main" else self._url.audio

    def _connect(self, group: str) -> Any:
        url = self._url_of(group)
        check_multicast(url)
        before = channel_filter.descriptors()
        try:
            link = lcm.LCM(url.text())
        except (OSError, RuntimeError, MemoryError, ValueError) as error:
            raise _multicast_error(url, str(error) or type(error).__name__) from error
        self._before[group] = before
        return link

    def _link(self, group: str) -> Any:
        if group not in self._links:
            self._links[group] = self._connect(group)
        return self._links[group]

    def _send(self, channel: str, payload: bytes) -> None:
        try:
            self._link(CHANNELS[channel].group).publish(channel, payload)
        except (OSError, MulticastError) as error:  # the group of audio may have no route
            self.counters.not_sent += 1
            if self.counters.not_sent == 1:
                log.error("not sent on %s: %s", channel, error)

    def _join(self, channel: Channel) -> None:
        link, group = self._link(channel.group), channel.group
        subscription = link.subscribe(channel.name, self._receive)
        # A full queue keeps the OLDEST messages; 0: no limit, pump drains it.
        subscription.set_queue_capacity(0)
        self._joined.setdefault(group, []).append(channel.name)
        if group not in self._sockets:
            # LCM opens its socket now or when it was made, and keeps it to itself: it is the new
            # one on this port.
            opened = channel_filter.descriptors() - self._before[group]
            self._sockets[group] = channel_filter.bound_to(opened, self._url_of(group).port)
        descriptor = self._sockets[group]
        if descriptor is not None:
            channel_filter.attach(descriptor, self._joined[group])

    def pump(self, timeout_s: float = 0.0) -> int:
        """Take everything that has arrived; see `Bus.pump`."""
        taken = 0
        timeout_ms = round(timeout_s * 1000)
        for link in self._links.values():
            taken += drain(link, timeout_ms)
            timeout_ms = 0
        return taken

    def fileno(self) -> int:
        """Return the descriptor that is readable while messages of the main group wait."""
        return int(self._links["main"].fileno())

    def close(self) -> None:
        """Leave the groups."""
        self._links.clear()


def open_udpm(url: str, clock: Clock, process: str) -> UdpmBus:
    """Open a process's endpoint.

    Args:
        url: LCM URL; empty: LCM's default group with ttl=0.
        clock: Stamps received messages.
        process: Name, as in the channel table's publishers.

    Raises:
        BusError: The URL is not one.
        MulticastError: This machine does not carry multicast.
    """
    return UdpmBus(parse_udpm_url(url), clock, process)


def foreign_traffic(url: str, listen_s: float = 0.5) -> dict[str, int]:
    """Listen before a show starts: who else publishes on this group?

    Args:
        url: LCM URL, as for `open_udpm`.
        listen_s: How long to listen [s].

    Returns:
        Channel -> messages heard.
    """
    parsed = parse_udpm_url(url)
    check_multicast(parsed)
    heard: dict[str, int] = {}

    def count(channel: str, _payload: bytes) -> None:
        heard[channel] = heard.get(channel, 0) + 1

    link = lcm.LCM(parsed.text())
    link.subscribe(".*", count).set_queue_capacity(0)
    end = time.monotonic() + listen_s
    while (left_s := end - time.monotonic()) > 0:
        link.handle_timeout(max(1, int(left_s * 1000)))
    heard.pop("LCM_SELF_TEST", None)
    return dict(sorted(heard.items()))
