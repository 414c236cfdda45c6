"""The traffic generator: deterministic, and each impairment does what its name says."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from downbeat.lcm_types import audio_chunk_t, g1_low_state_t, skill_request_t
from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.bus_types import BusError
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.runtime.codec import CodecError, codec_for
from downbeat.runtime.traffic import (
    Impairer,
    Impairment,
    Injection,
    Injector,
    damaged,
    set_path,
)

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


# ---------------------------------------------------------------------------- any plan


shares = st.floats(0, 1)
windows = st.tuples(st.floats(0, 0.3), st.floats(0, 0.3)).map(lambda w: (w[0], w[0] + w[1]))
impairments = st.builds(
    lambda window, **what: Impairment(CHANNEL, *window, **what),
    windows,
    drop=shares,
    delay_ms=st.floats(0, 50),
    jitter_ms=st.floats(0, 50),
    duplicate=shares,
    reorder=shares,
    hold=st.booleans(),
    freeze=st.booleans(),
    damage=st.sampled_from(["", "flip", "truncate", "extend", "fingerprint", "noise", "empty"]),
    damage_share=shares,
    set_fields=st.sampled_from([{}, {"joint_pos": math.nan}, {"imu_pelvis.gyro[2]": 3.0}]),
    set_share=shares,
    clock_step_s=st.sampled_from([0.0, -3600.0, 3600.0]),
)


def states(count=100):
    codec, msg = codec_for(g1_low_state_t), g1_low_state_t()
    for number in range(count):
        msg.header.utime, msg.header.seq = START + number * PERIOD_US, number
        yield msg.header.utime, codec.encode(msg)


def played(plan, seed):
    impairer = Impairer(plan, START, seed)
    arrived = []
    for utime, payload in states():
        impairer.feed(utime, CHANNEL, payload)
        arrived += [(utime, payload) for _, payload in impairer.take(utime)]
    while impairer.next_utime is not None:
        utime = impairer.next_utime
        arrived += [(utime, payload) for _, payload in impairer.take(utime)]
    return arrived


@given(st.lists(impairments, max_size=3), st.integers(0, 1000))
@settings(max_examples=40)
def test_any_plan_is_repeatable_and_leaves_the_rest_alone(plan, seed):
    arrived = played(plan, seed)
    assert arrived == played(plan, seed)
    assert [utime for utime, _ in arrived] == sorted(utime for utime, _ in arrived)
    assert len(arrived) <= 100 * 2 ** len(plan)
    there = set(arrived)
    for utime, payload in states():
        time_s = (utime - START) * 1e-6
        if all(time_s < one.from_s - 1e-6 or time_s > one.to_s for one in plan):
            assert (utime, payload) in there


@given(st.lists(impairments, min_size=1, max_size=3), st.integers(0, 1000))
@settings(max_examples=20)
def test_a_bus_survives_any_plan(plan, seed):
    clock, hub = SimClock(START), MemqHub()
    hub.impair(Impairer(plan, START, seed))
    receiver = hub.endpoint("control", clock)
    receiver.subscribe(CHANNEL)
    for utime, payload in states():
        clock.advance_to(utime)
        hub.deliver(utime, CHANNEL, payload)
        receiver.pump()
    for received in receiver.take(CHANNEL):
        assert all(map(math.isfinite, received.msg.joint_pos))


injections = st.builds(
    lambda at_s, length_s, **what: Injection("SKILL_REQUEST", at_s, at_s + length_s, **what),
    st.floats(0, 1),
    st.floats(0, 1),
    rate_hz=st.sampled_from([0.0, 1.0, 50.0, 333.0]),
    epoch=st.integers(1, 3),
    fields=st.just({"skill": "kpop", "request_id": 7}),
    count=st.sampled_from([{}, {"request_id": 1}]),
    vary=st.sampled_from([{}, {"start_phase_s": [0.0, 0.5]}]),
)


@given(st.lists(injections, max_size=4), st.integers(0, 1000))
def test_any_injections_come_in_order_with_one_sequence_per_publisher(plan, seed):
    made = list(Injector(plan, START, seed).take(START + 10**8))
    assert made == list(Injector(plan, START, seed).take(START + 10**8))
    assert len(made) == sum(one.number for one in plan)
    assert [utime for utime, _, _ in made] == sorted(utime for utime, _, _ in made)
    seqs = {}
    for utime, _, payload in made:
        header = skill_request_t.decode(payload).header
        assert header.utime == utime
        seqs.setdefault(header.epoch, []).append(header.seq)
    assert all(found == list(range(len(found))) for found in seqs.values())


# ---------------------------------------------------------------------------- details


def test_held_messages_arrive_together_when_the_window_ends():
    arrived = stream((Impairment(CHANNEL, 0.1, 0.2, hold=True),))
    assert [n for _, n in arrived] == list(range(200))
    burst = [n for utime, n in arrived if utime == START + 200_000]
    assert burst == list(range(50, 101))


def test_frozen_content_keeps_its_live_header():
    plan = (Impairment(CHANNEL, 0.1, freeze_content=True),)
    msgs = [g1_low_state_t.decode(payload) for _, payload in played(plan, 0)]
    assert [m.header.seq for m in msgs] == list(range(100))
    codec, msg = codec_for(g1_low_state_t), g1_low_state_t()
    impairer = Impairer((Impairment(CHANNEL, freeze_content=True),), START)
    for number, value in enumerate((0.1, 0.2)):
        msg.header.seq, msg.joint_pos = number, [value] * 29
        impairer.feed(START, CHANNEL, codec.encode(msg))
    first, second = (g1_low_state_t.decode(payload) for _, payload in impairer.take(START))
    assert list(second.joint_pos) == list(first.joint_pos)
    assert (first.header.seq, second.header.seq) == (0, 1)


def test_fields_are_set_in_their_share_of_messages_only():
    plan = (Impairment(CHANNEL, set_fields={"joint_pos[3]": 1.5}, set_share=0.3),)
    msgs = [g1_low_state_t.decode(payload) for _, payload in played(plan, 0)]
    assert 15 < sum(m.joint_pos[3] == 1.5 for m in msgs) < 45
    assert all(m.joint_pos[4] == 0.0 for m in msgs)


def test_counted_and_varied_fields_change_with_every_message():
    one = Injection(
        "SKILL_REQUEST",
        0.0,
        1.0,
        10.0,
        fields={"request_id": 100},
        count={"request_id": 2},
        vary={"start_phase_s": (0.0, 0.5)},
    )
    msgs = [skill_request_t.decode(p) for _, _, p in Injector((one,), START).take(START + 10**7)]
    assert [m.request_id for m in msgs] == list(range(100, 120, 2))
    phases = [m.start_phase_s for m in msgs]
    assert len(set(phases)) == 10
    assert all(0.0 <= phase <= 0.5 for phase in phases)


def test_each_run_on_a_bus_is_a_new_publisher():
    one = Injection("ESTOP", 0.0, epoch=5)
    ((_, _, payload),) = Injector((one,), START, epoch_offset=1000).take(START)
    assert CHANNELS["ESTOP"].type.decode(payload).header.epoch == 1005


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("joint_pso", 1.0, "no field 'joint_pso'; g1_low_state_t has battery_soc"),
        ("imu_pelvis.giro", 1.0, "imu_t has accel"),
        ("battery_soc.level", 1.0, "it is no struct"),
        ("joint_pos[29]", 1.0, "29 elements"),
        ("joint_pos[-1]", 1.0, "not a path"),
        ("joint_pos", [1.0, 2.0], "29 elements"),
        ("battery_soc[0]", 1.0, "no array"),
        ("battery_soc", "full", "numbers"),
        ("tick", 1.5, "integers"),
        ("source", True, "numbers"),
    ],
)
def test_impossible_changes_of_fields_are_refused(path, value, reason):
    with pytest.raises(BusError, match=reason):
        set_path(g1_low_state_t(), path, value, "here")


def test_arrays_of_bytes_and_of_any_length_can_be_set():
    state = g1_low_state_t.decode(codec_for(g1_low_state_t).encode(g1_low_state_t()))
    set_path(state, "wireless_remote", 7, "here")
    set_path(state, "wireless_remote[2]", 255, "here")
    assert state.wireless_remote == bytes([7, 7, 255] + [7] * 37)
    chunk = audio_chunk_t()
    set_path(chunk, "samples", [1, 2, 3], "here")
    assert list(chunk.samples) == [1, 2, 3]


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ({"drop": -0.1}, "drop is -0.1; valid are 0 to 1"),
        ({"jitter_ms": math.inf}, "jitter_ms is inf"),
        ({"from_s": 2.0, "to_s": 1.0}, "to_s is 1"),
        ({"clock_step_s": math.nan}, "finite"),
        ({"hold": True}, "needs to_s"),
    ],
)
def test_impossible_impairments_are_refused(what, reason):
    with pytest.raises(BusError, match=reason):
        Impairer((Impairment(CHANNEL, **what),), START)
