"""What all buses share: stamping and checking on the way out, judging on the way in."""

from __future__ import annotations

import logging
import math
import struct
from collections import deque
from collections.abc import Callable
from typing import Any

from downbeat.lcm_types.channels import CHANNELS, Channel
from downbeat.runtime.bus_types import BusCounters, BusError, Freshness, Received
from downbeat.runtime.clock import Clock
from downbeat.runtime.codec import Codec, CodecError, codec_for
from downbeat.runtime.errors import one_of
from downbeat.runtime.sequence import PublisherGuard, Verdict

log = logging.getLogger("downbeat.bus")

KEPT_EVENTS = 4096
"""Messages kept between two takes of an event channel; the oldest go first."""
KEPT_STATE_S = 2.0
"""The same for channels with a rate, as time; at least 64 messages."""
RATE_WINDOW_US = 1_000_000
RATE_TOLERANCE = 0.9
HEAD = struct.Struct(">8sqqq")
"""Every message: fingerprint, then the header's utime, seq, epoch."""
SEQ_EPOCH, SEQ_OFFSET = struct.Struct(">qq"), 16


def channel_named(name: str) -> Channel:
    """Return a row of the channel table.

    Raises:
        BusError: There is none of that name.
    """
    channel = CHANNELS.get(name)
    if channel is None:
        raise BusError(
            f"Channel {name!r} is not in the channel table (lcm_types/channels.py); "
            f"it has {one_of(CHANNELS)}."
        )
    return channel


def _is_power_of_two(count: int) -> bool:
    """Log the 1st, 2nd, 4th, 8th ... time: a line per change of scale, never a flood."""
    return count & (count - 1) == 0


class _Subscription:
    """State of one received channel."""

    __slots__ = (
        "channel",
        "codec",
        "count",
        "fingerprint",
        "is_newest_only",
        "judged",
        "guard",
        "latest",
        "pending",
        "queue",
        "window",
    )

    def __init__(self, channel: Channel, is_newest_only: bool = False) -> None:
        self.channel = channel
        self.codec: Codec = codec_for(channel.type)
        self.fingerprint: bytes = channel.type._get_packed_fingerprint()
        self.is_newest_only = is_newest_only
        self.latest: Received | None = None
        kept = max(64, int(KEPT_STATE_S * channel.rate_hz)) if channel.rate_hz else KEPT_EVENTS
        self.queue: deque[Received] = deque(maxlen=kept)
        self.pending: deque[tuple[bytes, int]] = deque(maxlen=kept)
        self.guard = PublisherGuard(channel)
        self.count = 0
        self.window: tuple[int, int, bool] | None = None
        self.judged: tuple[bool, bool] | None = None


class Endpoint:
    """Base of the buses; they add `_send` and `pump`."""

    def __init__(self, clock: Clock, process: str, epoch: int) -> None:
        """Make an endpoint.

        Args:
            clock: Stamps received messages.
            process: Who we are, as in the channel table's publishers.
            epoch: header.epoch of everything we publish.
        """
        self.clock = clock
        self.process = process
        self.epoch = epoch
        self.counters = BusCounters()
        self.tap: Callable[[str, bytes], None] | None = None
        """Sees every payload that comes in or goes out, bad ones too: for the black box."""
        self._subscriptions: dict[str, _Subscription] = {}
        self._next_seqs: dict[str, int] = {}

    def publish(self, channel: str, msg: Any) -> int:
        """Stamp, check, encode, send; see `Bus.publish`."""
        seq = self._next_seqs.get(channel)
        if seq is None:
            self._check_publisher(channel)
            seq = 0
        codec = codec_for(CHANNELS[channel].type)
        header = msg.header
        header.seq = seq
        header.epoch = self.epoch
        payload = codec.encode(msg)
        if self.tap is not None:
            self.tap(channel, payload)
        self._next_seqs[channel] = seq + 1
        self._send(channel, payload)
        return seq

    def publish_encoded(self, channel: str, payload: bytearray) -> int:
        """Stamp and send a message that is encoded already; see `Bus.publish_encoded`."""
        seq = self._next_seqs.get(channel)
        if seq is None:
            self._check_publisher(channel)
            seq = 0
        SEQ_EPOCH.pack_into(payload, SEQ_OFFSET, seq, self.epoch)
        encoded = bytes(payload)
        if self.tap is not None:
            self.tap(channel, encoded)
        self._next_seqs[channel] = seq + 1
        self._send(channel, encoded)
        return seq

    def _check_publisher(self, channel: str) -> None:
        publishers = channel_named(channel).publishers
        if publishers and self.process not in publishers:
            raise BusError(
                f"Process {self.process!r} may not publish {channel}; "
                f"its publishers are {one_of(publishers)} (lcm_types/channels.py)."
            )

    def _send(self, channel: str, payload: bytes) -> None:
        raise NotImplementedError

    def subscribe(self, *channels: str) -> None:
        """Receive channels from now on; see `Bus.subscribe`."""
        self._subscribe(channels, is_newest_only=False)

    def subscribe_newest(self, *channels: str) -> None:
        """Receive channels of which only the newest message counts; see `Bus.subscribe_newest`."""
        self._subscribe(channels, is_newest_only=True)

    def _subscribe(self, channels: tuple[str, ...], is_newest_only: bool) -> None:
        for name in channels:
            channel = channel_named(name)
            if name not in self._subscriptions:
                self._subscriptions[name] = _Subscription(channel, is_newest_only)
                self._join(channel)

    def _join(self, channel: Channel) -> None:
        """Tell the transport; nothing to do for most."""

    def _receive(self, channel: str, payload: bytes) -> None:
        """Decode and judge one message; counts what is bad, never raises."""
        subscription = self._subscriptions.get(channel)
        if subscription is None:
            return
        if self.tap is not None:
            self.tap(channel, payload)
        if subscription.is_newest_only and subscription.codec.looks_valid(payload):
            self._keep(subscription, payload)
            return
        msg = self._decode(subscription, payload)
        if msg is None:
            return
        header = msg.header
        if not self._in_sequence(subscription, header.epoch, header.seq):
            return
        received = Received(channel, msg, self.clock.utime())
        subscription.latest = received
        subscription.queue.append(received)
        subscription.count += 1

    def _decode(self, subscription: _Subscription, payload: bytes) -> Any:
        """Decode and check a payload; None, and counted, if it is bad."""
        channel = subscription.channel.name
        try:
            return subscription.codec.decode(payload, channel)
        except CodecError as error:
            total = self.counters.add_rejected(channel)
            if _is_power_of_two(total):
                log.warning("rejected %d on %s: %s", total, channel, error)
            return None

    def _keep(self, subscription: _Subscription, payload: bytes) -> None:
        """Follow the header of a message; its content is looked at when somebody asks.

        Only the plain case is put off: the next message of the publisher that is known. Anything
        else, a new publisher above all, is believed only if all of it is valid.
        """
        _fingerprint, _utime, seq, epoch = HEAD.unpack_from(payload)
        utime = self.clock.utime()
        if not subscription.guard.is_next(epoch, seq, utime) and (
            self._decode(subscription, payload) is None
            or not self._in_sequence(subscription, epoch, seq)
        ):
            return
        subscription.pending.append((payload, utime))
        subscription.count += 1

    def _judge_pending(self, subscription: _Subscription) -> None:
        """Make the newest valid one of the kept messages the latest; forget the others."""
        pending = subscription.pending
        while pending:
            payload, recv_utime = pending.pop()
            msg = self._decode(subscription, payload)
            if msg is not None:
                subscription.latest = Received(subscription.channel.name, msg, recv_utime)
                pending.clear()
            else:
                subscription.count -= 1

    def _in_sequence(self, subscription: _Subscription, epoch: int, seq: int) -> bool:
        """Follow sequence numbers and publishers; count and say what is wrong."""
        verdict, lost = subscription.guard.judge(epoch, seq, self.clock.utime())
        channel = subscription.channel.name
        if verdict is Verdict.GOOD:
            if lost:
                log.debug("lost %d on %s", self.counters.add_lost(channel, lost), channel)
            return True
        if verdict is Verdict.FOREIGN:
            total = self.counters.add_foreign(channel)
            if _is_power_of_two(total):
                log.error("second publisher on %s: %d messages dropped", channel, total)
            return False
        total = self.counters.add_rejected(channel)
        if _is_power_of_two(total):
            log.warning("rejected %d on %s: seq %d is %s", total, channel, seq, verdict.value)
        return False

    def latest(self, channel: str) -> Received | None:
        """Return the last valid message; see `Bus.latest`."""
        subscription = self._subscription(channel)
        if subscription.pending:
            self._judge_pending(subscription)
        return subscription.latest

    def take(self, channel: str) -> list[Received]:
        """Return all valid messages since the last take, in order; see `Bus.take`."""
        subscription = self._subscription(channel)
        if subscription.is_newest_only:
            raise BusError(
                f"Process {self.process!r} subscribed to the newest {channel} only; "
                "`latest` has it, `take` needs `subscribe`."
            )
        queue = subscription.queue
        if not queue:
            return []
        taken = list(queue)
        queue.clear()
        return taken

    def _subscription(self, channel: str) -> _Subscription:
        subscription = self._subscriptions.get(channel)
        if subscription is None:
            raise BusError(
                f"Process {self.process!r} asked for {channel} without subscribing; "
                f"it subscribed to {one_of(self._subscriptions)}."
            )
        return subscription

    def freshness(self, channel: str, utime: int) -> Freshness:
        """Judge a subscription; see `Bus.freshness`."""
        subscription = self._subscription(channel)
        row = subscription.channel
        latest = self.latest(channel)
        age_s = math.inf if latest is None else max(0, utime - latest.recv_utime) * 1e-6
        alive = latest is not None and age_s <= row.stale_after_s
        rate_ok = alive if row.rate_hz else True
        if row.rate_hz and alive:
            rate_ok = _rate_ok(subscription, utime)
        verdict = (alive, rate_ok)
        if subscription.judged is not None and verdict != subscription.judged:
            log.warning(
                "%s: %s alive=%s rate_ok=%s age=%.3f s",
                self.process,
                channel,
                alive,
                rate_ok,
                age_s,
            )
        subscription.judged = verdict
        return Freshness(
            alive=alive,
            rate_ok=rate_ok,
            age_s=age_s,
            count=subscription.count,
            lost=self.counters.lost_on(channel),
            rejected=self.counters.rejected_on(channel),
        )

    def close(self) -> None:
        """Leave the bus; what arrived stays readable."""


def _rate_ok(subscription: _Subscription, utime: int) -> bool:
    """Compare the rate of the last full window with the nominal one; True until one is full."""
    window = subscription.window
    if window is None:
        subscription.window = (utime, subscription.count, True)
        return True
    start, count_then, verdict = window
    row = subscription.channel
    length_us = max(RATE_WINDOW_US, int(10e6 / row.rate_hz))
    elapsed = utime - start
    if elapsed >= length_us:
        rate_hz = (subscription.count - count_then) / (elapsed * 1e-6)
        verdict = rate_hz >= RATE_TOLERANCE * row.rate_hz
        subscription.window = (utime, subscription.count, verdict)
    return verdict
