"""Both buses: same checks, same counters; memq in order and deterministic, udpm for real."""

import logging
import math
import subprocess
import sys
import time

import lcm
import numpy as np
import pytest
from sample_messages import low_state, request

from downbeat.lcm_types import (
    audio_chunk_t,
    estop_t,
    g1_low_cmd_t,
    g1_low_state_t,
    heartbeat_t,
    skill_request_t,
)
from downbeat.runtime.bus import (
    BusError,
    MemqHub,
    foreign_traffic,
    open_udpm,
    parse_udpm_url,
)
from downbeat.runtime.clock import SimClock, WallClock
from downbeat.runtime.codec import CodecError, codec_for


class Pair:
    """A sender and a receiver on one bus, and how to inject raw bytes."""

    def __init__(self, clock, sender, receiver, inject):
        self.clock = clock
        self.sender = sender
        self.receiver = receiver
        self.inject = inject

    def pump(self, count):
        """Take `count` messages, waiting for the network if there is one."""
        taken = 0
        for _ in range(200):
            taken += self.receiver.pump(0.01)
            if taken >= count:
                return
        raise AssertionError(f"{taken} of {count} messages came")

    def wait(self, seconds):
        """Let the clock of the bus go on."""
        if isinstance(self.clock, SimClock):
            self.clock.advance_to(self.clock.utime() + round(seconds * 1e6))
        else:
            time.sleep(seconds)


@pytest.fixture(params=["memq", "udpm"])
def pair_of(request):
    """A function (sender name, receiver name) -> Pair, for both transports."""
    open_buses = []

    def make(sender, receiver):
        if request.param == "memq":
            clock = SimClock()
            hub = MemqHub()
            buses = [hub.endpoint(name, clock) for name in (sender, receiver)]

            def inject(channel, payload):
                hub.deliver(clock.utime(), channel, payload)
        else:
            url = request.getfixturevalue("free_url")
            clock = WallClock()
            buses = [open_udpm(url, clock, name) for name in (sender, receiver)]
            raw = lcm.LCM(parse_udpm_url(url).text())
            inject = raw.publish
        open_buses.extend(buses)
        return Pair(clock, *buses, inject)

    yield make
    for bus in open_buses:
        bus.close()


def test_message_arrives_with_seq_epoch_and_arrays(pair_of):
    pair = pair_of("sim", "control")
    pair.receiver.subscribe("G1_LOW_STATE")
    assert pair.receiver.latest("G1_LOW_STATE") is None
    msg = low_state()
    msg.joint_pos = np.linspace(0.0, 1.0, 29)
    assert [pair.sender.publish("G1_LOW_STATE", msg) for _ in range(3)] == [0, 1, 2]
    pair.pump(3)
    received = pair.receiver.take("G1_LOW_STATE")
    assert [r.msg.header.seq for r in received] == [0, 1, 2]
    assert len({r.msg.header.epoch for r in received}) == 1
    assert pair.receiver.take("G1_LOW_STATE") == []
    latest = pair.receiver.latest("G1_LOW_STATE")
    assert latest is received[-1] and latest.channel == "G1_LOW_STATE"
    np.testing.assert_array_equal(latest.msg.joint_pos, msg.joint_pos.astype(np.float32))


def test_bad_payloads_are_counted_and_dropped(pair_of, caplog):
    pair = pair_of("conductor", "control")
    pair.receiver.subscribe("SKILL_REQUEST", "G1_LOW_STATE")
    good = codec_for(skill_request_t).encode(request())
    for payload in (b"", b"junk" * 50, good[:-1], good + b"\0", estop_t().encode()):
        pair.inject("SKILL_REQUEST", payload)
    unhealthy = low_state()
    unhealthy.joint_pos[3] = math.nan
    pair.inject("G1_LOW_STATE", codec_for(g1_low_state_t).encode(unhealthy))
    pair.sender.publish("SKILL_REQUEST", request())
    with caplog.at_level(logging.WARNING):
        pair.pump(7)
    counters = pair.receiver.counters
    assert (counters.rejected, counters.rejected_on("SKILL_REQUEST")) == (6, 5)
    assert counters.rejected_on("G1_LOW_STATE") == 1
    assert "joint_pos[3]" in caplog.text
    assert len(pair.receiver.take("SKILL_REQUEST")) == 1
    assert pair.receiver.latest("G1_LOW_STATE") is None


def test_newest_only_skips_what_is_superseded_and_what_is_bad(pair_of, caplog):
    pair = pair_of("sim", "control")
    pair.receiver.subscribe_newest("G1_LOW_STATE")
    codec = codec_for(g1_low_state_t)
    for seq, is_bad in enumerate((False, False, True, True)):
        msg = low_state()
        msg.header.seq, msg.header.epoch = seq, 5
        if is_bad:
            msg.joint_vel[7] = math.inf
        pair.inject("G1_LOW_STATE", codec.encode(msg))
    pair.inject("G1_LOW_STATE", b"junk" * 50)
    pair.inject("G1_LOW_STATE", codec.encode(low_state())[:20])
    pair.pump(6)
    assert pair.receiver.latest("G1_LOW_STATE").msg.header.seq == 1
    assert pair.receiver.counters.rejected_on("G1_LOW_STATE") == 4
    assert pair.receiver.counters.lost_on("G1_LOW_STATE") == 0
    assert pair.receiver.freshness("G1_LOW_STATE", pair.clock.utime()).count == 2
    with pytest.raises(BusError, match="newest"):
        pair.receiver.take("G1_LOW_STATE")


def test_newest_only_still_sees_gaps_and_a_second_publisher(pair_of):
    pair = pair_of("sim", "control")
    pair.receiver.subscribe_newest("G1_LOW_STATE")
    codec = codec_for(g1_low_state_t)
    for seq, epoch in ((0, 1), (3, 1), (0, 2), (4, 1)):
        msg = low_state()
        msg.header.seq, msg.header.epoch = seq, epoch
        pair.inject("G1_LOW_STATE", codec.encode(msg))
    pair.pump(4)
    counters = pair.receiver.counters
    assert counters.lost_on("G1_LOW_STATE") == 2
    assert counters.foreign_on("G1_LOW_STATE") == 1
    assert pair.receiver.latest("G1_LOW_STATE").msg.header.epoch == 1


def test_gaps_are_counted_as_lost_and_a_new_epoch_starts_over(pair_of):
    pair = pair_of("control", "sim")
    pair.receiver.subscribe("G1_LOW_CMD")
    codec = codec_for(g1_low_cmd_t)

    def inject(epoch, seq):
        msg = g1_low_cmd_t()
        msg.header.epoch, msg.header.seq = epoch, seq
        pair.inject("G1_LOW_CMD", codec.encode(msg))

    for epoch, seq in [(5, 10), (5, 11), (5, 15), (5, 15), (5, 14)]:
        inject(epoch, seq)
    pair.pump(5)
    pair.wait(0.12)  # the first publisher is dead for longer than the channel may be stale
    for epoch, seq in [(6, 0), (6, 1)]:
        inject(epoch, seq)
    pair.pump(2)
    assert pair.receiver.counters.lost_on("G1_LOW_CMD") == 3
    assert pair.receiver.counters.lost == 3
    assert pair.receiver.counters.rejected_on("G1_LOW_CMD") == 2
    assert pair.receiver.counters.foreign == 0
    assert pair.receiver.freshness("G1_LOW_CMD", pair.clock.utime()).count == 5


def test_second_publisher_is_a_fault_and_its_messages_are_dropped(pair_of):
    pair = pair_of("control", "sim")
    pair.receiver.subscribe("G1_LOW_CMD", "HEARTBEAT")
    for name, cls in (("G1_LOW_CMD", g1_low_cmd_t), ("HEARTBEAT", heartbeat_t)):
        for epoch, seq in [(5, 0), (6, 0), (5, 1), (6, 1), (5, 2)]:
            msg = cls()
            msg.header.epoch, msg.header.seq = epoch, seq
            pair.inject(name, codec_for(cls).encode(msg))
    pair.pump(10)
    counters = pair.receiver.counters
    assert counters.foreign_on("G1_LOW_CMD") == 2
    assert counters.foreign_channels == ("G1_LOW_CMD",)  # anybody may publish HEARTBEAT
    epochs = [r.msg.header.epoch for r in pair.receiver.take("G1_LOW_CMD")]
    assert epochs == [5, 5, 5]  # the first stays: nobody takes a robot over by talking louder
    assert len(pair.receiver.take("HEARTBEAT")) == 5


def test_wrong_channel_publisher_or_message_is_refused(pair_of):
    pair = pair_of("listener", "control")
    with pytest.raises(BusError, match="may not publish G1_LOW_CMD.*control"):
        pair.sender.publish("G1_LOW_CMD", g1_low_cmd_t())
    with pytest.raises(BusError, match="not in the channel table"):
        pair.sender.publish("NO_SUCH", g1_low_cmd_t())
    with pytest.raises(BusError, match="not in the channel table"):
        pair.receiver.subscribe("NO_SUCH")
    with pytest.raises(BusError, match="without subscribing"):
        pair.receiver.latest("ESTOP")
    with pytest.raises(CodecError):
        pair.sender.publish("ESTOP", heartbeat_t())
    assert pair.sender.publish("ESTOP", estop_t()) == 0


def test_endpoints_that_did_not_subscribe_get_nothing(pair_of):
    pair = pair_of("sim", "control")
    pair.receiver.subscribe("ESTOP")
    pair.sender.publish("G1_LOW_STATE", low_state())
    pair.sender.publish("ESTOP", estop_t())
    pair.pump(1)
    assert pair.receiver.pump() == 0


def test_freshness_follows_age_and_rate_and_logs_once_per_change(caplog):
    clock = SimClock()
    hub = MemqHub()
    sim, control = hub.endpoint("sim", clock), hub.endpoint("control", clock)
    control.subscribe("G1_LOW_STATE", "ESTOP")
    before = control.freshness("G1_LOW_STATE", clock.utime())
    assert (before.alive, before.age_s) == (False, math.inf)

    def run(seconds, every_us):
        end = clock.utime() + int(seconds * 1e6)
        while clock.utime() < end:
            clock.advance_to(clock.utime() + 2_000)
            if clock.utime() % every_us == 0:
                sim.publish("G1_LOW_STATE", low_state(clock.utime()))
            control.pump()
            control.freshness("G1_LOW_STATE", clock.utime())
        return control.freshness("G1_LOW_STATE", clock.utime())

    with caplog.at_level(logging.WARNING):
        good = run(2.5, 2_000)
        assert good.alive and good.rate_ok and good.age_s == 0.0
        slow = run(2.5, 4_000)
        assert slow.alive and not slow.rate_ok
        dead = run(0.1, 10**9)
        assert not dead.alive and dead.age_s == pytest.approx(0.1)
    assert len(caplog.records) == 3  # came alive, became slow, died
    sim.publish("ESTOP", estop_t())
    control.pump()
    clock.advance_to(clock.utime() + 3600 * 1_000_000)
    event = control.freshness("ESTOP", clock.utime())
    assert event.alive and event.rate_ok and event.age_s == pytest.approx(3600.0)


def test_memq_receivers_own_their_copies():
    clock = SimClock()
    hub = MemqHub()
    sim = hub.endpoint("sim", clock)
    receivers = [hub.endpoint(name, clock) for name in ("control", "recorder")]
    for receiver in receivers:
        receiver.subscribe("G1_LOW_STATE")
    sim.publish("G1_LOW_STATE", low_state())
    for receiver in receivers:
        receiver.pump()
    first, second = (r.latest("G1_LOW_STATE").msg for r in receivers)
    first.joint_pos[:] = 1.0
    assert not second.joint_pos.any()


def test_memq_runs_are_byte_identical():
    def run():
        clock = SimClock()
        hub = MemqHub(seed=7)
        seen = []
        hub.tap(lambda *event: seen.append(event))
        sim, control = hub.endpoint("sim", clock), hub.endpoint("control", clock)
        control.subscribe("G1_LOW_STATE")
        for _ in range(10):
            clock.advance_to(clock.utime() + 20_000)
            sim.publish("G1_LOW_STATE", low_state(clock.utime()))
            control.pump()
            control.publish("G1_LOW_CMD", g1_low_cmd_t())
        return seen

    assert run() == run()


def test_memq_process_name_is_unique():
    hub = MemqHub()
    hub.endpoint("sim", SimClock())
    with pytest.raises(BusError, match="already"):
        hub.endpoint("sim", SimClock())


def test_udpm_burst_while_asleep_loses_nothing_and_keeps_the_newest(free_url):
    clock = WallClock()
    sender, receiver = (open_udpm(free_url, clock, name) for name in ("sim", "control"))
    receiver.subscribe("G1_LOW_STATE")
    for _ in range(200):
        sender.publish("G1_LOW_STATE", low_state())
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        receiver.pump(0.05)
        latest = receiver.latest("G1_LOW_STATE")
        if latest is not None and latest.msg.header.seq == 199:
            break
    assert receiver.latest("G1_LOW_STATE").msg.header.seq == 199
    assert receiver.counters.lost == 0


def test_udpm_audio_has_a_group_and_a_port_of_its_own(free_url):
    clock = WallClock()
    source, listener = (open_udpm(free_url, clock, name) for name in ("source", "listener"))
    plain = lcm.LCM(parse_udpm_url(free_url).text())
    on_main = []
    plain.subscribe("AUDIO_CHUNK", lambda *event: on_main.append(event))
    main, audio = parse_udpm_url(free_url), parse_udpm_url(free_url).audio
    assert (audio.group, audio.port) == ("239.255.76.66", main.port + 1)
    assert audio.audio.group == main.group and main.both_groups == "239.255.76.66/31"
    to_audio = lcm.LCM(audio.text())
    on_audio = []
    to_audio.subscribe("AUDIO_CHUNK", lambda *event: on_audio.append(event))
    listener.subscribe("AUDIO_CHUNK")
    chunk = audio_chunk_t()
    chunk.sample_rate_hz, chunk.num_samples = 16_000, 160
    chunk.samples = np.arange(160, dtype=np.int16)
    source.publish("AUDIO_CHUNK", chunk)
    for _ in range(100):
        if listener.pump(0.02):
            break
    np.testing.assert_array_equal(listener.latest("AUDIO_CHUNK").msg.samples, chunk.samples)
    assert plain.handle_timeout(50) == 0 and not on_main
    assert to_audio.handle_timeout(1000) and len(on_audio) == 1


def test_foreign_traffic_names_the_channels(free_url):
    assert foreign_traffic(free_url, 0.05) == {}
    code = (
        "import sys, time, lcm\n"
        "link = lcm.LCM(sys.argv[1])\n"
        "for _ in range(400):\n"
        "    link.publish('SOMEBODY', b'x'); time.sleep(0.01)\n"
    )
    other = subprocess.Popen([sys.executable, "-c", code, free_url])
    try:
        for _ in range(20):
            heard = foreign_traffic(free_url, 0.2)
            if heard:
                break
        assert list(heard) == ["SOMEBODY"]
    finally:
        other.terminate()
        other.wait()


@pytest.mark.parametrize(
    "url",
    [
        "tcpq://127.0.0.1:7700",
        "udpm://127.0.0.1:7667",
        "udpm://239.255.76.67:70000",
        "udpm://239.255.76.67:7667?ttl=x",
        "udpm://239.255.76.67:7667?ttl",
        "nonsense",
    ],
)
def test_url_that_is_not_multicast_is_refused(url):
    with pytest.raises(BusError, match="not an LCM multicast URL"):
        parse_udpm_url(url)


def test_url_gets_our_buffer_and_stays_on_this_machine():
    assert parse_udpm_url("").text() == ("udpm://239.255.76.67:7667?ttl=0&recv_buf_size=4194304")
    url = parse_udpm_url("udpm://239.255.76.68:7700?ttl=1&recv_buf_size=5")
    assert url.text() == "udpm://239.255.76.68:7700?ttl=1&recv_buf_size=5"


@pytest.mark.net
def test_without_multicast_the_error_says_what_to_type():
    code = (
        "from downbeat.runtime.bus import open_udpm, MulticastError\n"
        "from downbeat.runtime.clock import WallClock\n"
        "try: open_udpm('', WallClock(), 'sim')\n"
        "except MulticastError as error: print(error)\n"
    )
    command = ["unshare", "--net", sys.executable, "-c", code]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if "unshare" in result.stderr:
        pytest.skip("no right to make a network namespace")
    assert "ip route add 239.255.76.66/31 dev lo" in result.stdout
    assert "--lockstep" in result.stdout
