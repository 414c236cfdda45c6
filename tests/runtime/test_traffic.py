"""The traffic generator: deterministic, and each impairment does what its name says."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from downbeat.lcm_types import g1_low_state_t, skill_request_t
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.bus_types import BusError
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.runtime.codec import CodecError, codec_for
from downbeat.runtime.traffic import Impairer, Impairment, Injection, Injector, damaged

START = SIM_EPOCH_UTIME
CHANNEL = "G1_LOW_STATE"
PERIOD_US = 2_000


def stream(impairments, count=200, seed=0):
    """Publish numbered payloads at 500 Hz; return [(utime, number)] as they arrive."""
    impairer = Impairer(impairments, START, seed)
    arrived = []
    for number in range(count + 500):
        utime = START + number * PERIOD_US
        if number < count:
            impairer.feed(utime, CHANNEL, number.to_bytes(4, "big"))
        arrived += [(utime, int.from_bytes(p, "big")) for _, p in impairer.take(utime)]
    return arrived


def test_good_network_delivers_everything_in_order_at_once():
    assert stream(()) == [(START + n * PERIOD_US, n) for n in range(200)]


@given(
    drop=st.floats(0, 1),
    duplicate=st.floats(0, 1),
    jitter_ms=st.floats(0, 40),
    reorder=st.floats(0, 1),
    delay_ms=st.floats(0, 100),
    seed=st.integers(0, 1000),
)
@settings(max_examples=40)
def test_whatever_is_done_nothing_is_invented_and_nothing_is_early(
    drop, duplicate, jitter_ms, reorder, delay_ms, seed
):
    one = Impairment(
        CHANNEL,
        drop=drop,
        duplicate=duplicate,
        jitter_ms=jitter_ms,
        reorder=reorder,
        delay_ms=delay_ms,
    )
    arrived = stream((one,), seed=seed)
    numbers = [number for _, number in arrived]
    assert set(numbers) <= set(range(200))
    assert all(numbers.count(n) <= 2 for n in set(numbers))
    for utime, number in arrived:
        late_us = utime - (START + number * PERIOD_US)
        assert math.floor(delay_ms * 1e3) <= late_us <= (delay_ms + jitter_ms) * 1e3 + 3_000 + 2_000
    assert arrived == stream((one,), seed=seed)


def test_shares_are_what_was_asked_for():
    lost = 4000 - len(stream((Impairment(CHANNEL, drop=0.3),), 4000))
    assert lost / 4000 == pytest.approx(0.3, abs=0.03)
    doubled = len(stream((Impairment(CHANNEL, duplicate=0.2),), 4000)) - 4000
    assert doubled / 4000 == pytest.approx(0.2, abs=0.03)


def test_only_the_window_and_the_channel_are_touched():
    one = Impairment(CHANNEL, from_s=0.1, to_s=0.2, drop=1.0)
    numbers = [n for _, n in stream((one,))]
    assert numbers == [*range(50), *range(100, 200)]
    other = Impairment("SKILL_REQUEST", drop=1.0)
    assert len(stream((other,))) == 200


def test_frozen_publisher_repeats_its_first_message():
    numbers = [n for _, n in stream((Impairment(CHANNEL, from_s=0.1, freeze=True),))]
    assert numbers == [*range(50), *([50] * 150)]


def test_overtaken_messages_arrive_after_their_successor():
    arrived = [n for _, n in stream((Impairment(CHANNEL, reorder=0.5),))]
    assert sorted(arrived) == list(range(200))
    assert arrived != sorted(arrived)


def test_fields_are_set_and_clocks_are_stepped():
    codec = codec_for(skill_request_t)
    msg = skill_request_t()
    msg.header.utime, msg.start_phase_s = START, 1.5
    one = Impairment("SKILL_REQUEST", set_fields={"start_phase_s": math.nan}, clock_step_s=3600.0)
    impairer = Impairer((one,), START)
    impairer.feed(START, "SKILL_REQUEST", codec.encode(msg))
    ((_, payload),) = impairer.take(START)
    changed = skill_request_t.decode(payload)
    assert math.isnan(changed.start_phase_s)
    assert changed.header.utime == START + 3_600_000_000


@pytest.mark.parametrize("damage", ["truncate", "extend", "fingerprint", "noise", "empty"])
def test_damaged_payloads_are_refused_by_the_codec(damage):
    payload = codec_for(g1_low_state_t).encode(g1_low_state_t())
    rng = random.Random(1)
    for _ in range(50):
        with pytest.raises(CodecError):
            codec_for(g1_low_state_t).decode(damaged(payload, damage, rng))


def test_injections_come_at_their_rate_with_their_fields():
    one = Injection(
        "SKILL_REQUEST",
        0.5,
        1.5,
        10.0,
        fields={"skill": "kpop", "start_utime": 2.5, "velocity": 0.5},
    )
    injector = Injector((one,), START)
    messages = [(u, skill_request_t.decode(p)) for u, _, p in injector.take(START + 10**7)]
    assert [u for u, _ in messages] == [START + 500_000 + k * 100_000 for k in range(10)]
    assert [m.header.seq for _, m in messages] == list(range(10))
    assert messages[0][1].start_utime == START + 2_500_000
    assert list(messages[0][1].velocity) == [0.5, 0.5, 0.5]


@pytest.mark.parametrize(
    ("one", "reason"),
    [
        (Injection("NOWHERE", 0.0), "not in the channel table"),
        (Injection("SKILL_REQUEST", 0.0, fields={"skil": "kpop"}), "no field 'skil'"),
        (Injection("SKILL_REQUEST", 0.0, 1.0, 1e9), "valid are 0 to 5000"),
    ],
)
def test_impossible_injections_are_refused(one, reason):
    with pytest.raises(BusError, match=reason):
        Injector((one,), START)


def test_hub_with_a_bad_network_still_shows_the_good_one_to_its_taps():
    clock = SimClock(START)
    hub = MemqHub()
    published = []
    hub.tap(lambda utime, channel, payload: published.append(payload))
    hub.impair(Impairer((Impairment("SKILL_REQUEST", drop=1.0),), START))
    sender, receiver = hub.endpoint("conductor", clock), hub.endpoint("control", clock)
    receiver.subscribe("SKILL_REQUEST")
    sender.publish("SKILL_REQUEST", skill_request_t())
    assert len(published) == 1
    assert receiver.pump() == 0


def test_delayed_messages_arrive_when_the_clock_gets_there():
    clock = SimClock(START)
    hub = MemqHub()
    hub.impair(Impairer((Impairment("SKILL_REQUEST", delay_ms=50.0),), START))
    sender, receiver = hub.endpoint("conductor", clock), hub.endpoint("control", clock)
    receiver.subscribe("SKILL_REQUEST")
    sender.publish("SKILL_REQUEST", skill_request_t())
    clock.advance_to(START + 48_000)
    assert receiver.pump() == 0
    clock.advance_to(START + 50_000)
    assert receiver.pump() == 1
