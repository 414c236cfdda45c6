"""The codec: lcm-gen's bytes, faster, and nothing but CodecError for anything wrong."""

import math
import struct
from operator import attrgetter

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from message_strategies import messages

from downbeat.lcm_types import (
    audio_chunk_t,
    control_status_t,
    g1_low_cmd_t,
    g1_low_state_t,
    header_t,
    music_match_t,
    operator_command_t,
    skill_status_t,
    transition_query_t,
)
from downbeat.runtime.codec import CodecError, codec_for
from downbeat.runtime.codec_layout import known_types, layout_of
from downbeat.runtime.codec_slow import decode_slow, encode_slow

TYPES = known_types()
MESSAGE_TYPES = [cls for cls in TYPES.values() if "header" in cls.__slots__]
every_type = pytest.mark.parametrize("cls", TYPES.values(), ids=TYPES.keys())
every_message = pytest.mark.parametrize(
    "cls", MESSAGE_TYPES, ids=[cls.__name__ for cls in MESSAGE_TYPES]
)
few = settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))


def low_state() -> g1_low_state_t:
    msg = g1_low_state_t()
    msg.imu_pelvis.quat = [1.0, 0.0, 0.0, 0.0]
    msg.imu_torso.quat = [1.0, 0.0, 0.0, 0.0]
    msg.wireless_remote = bytes(40)
    return msg


def same(a, b) -> bool:
    if isinstance(a, float) and math.isnan(a):
        return isinstance(b, float) and math.isnan(b)
    return a == b


@every_type
@few
@given(data=st.data())
def test_bytes_are_those_of_lcm_gen(cls, data):
    msg = data.draw(messages(layout_of(cls), as_array=False))
    assert codec_for(cls).encode(msg) == msg.encode()


@every_type
@few
@given(data=st.data())
def test_arrays_and_lists_encode_to_the_same_bytes_as_field_by_field(cls, data):
    layout = layout_of(cls)
    msg = data.draw(messages(layout))
    assert codec_for(cls).encode(msg) == encode_slow(layout, msg)


@every_type
@few
@given(data=st.data())
def test_round_trip_gives_the_same_values_and_bytes(cls, data):
    layout = layout_of(cls)
    codec = codec_for(cls)
    msg = data.draw(messages(layout))
    payload = codec.encode(msg)
    back = codec.decode(payload)
    assert codec.encode(back) == payload
    slow = decode_slow(layout, payload, cls.__name__)
    for leaf in layout.leaves:
        sent, got = attrgetter(leaf.name)(msg), attrgetter(leaf.name)(back)
        if leaf.kind in ("array", "varray"):
            assert isinstance(got, np.ndarray) and got.dtype.isnative
            np.testing.assert_array_equal(got, np.asarray(sent, got.dtype))
            np.testing.assert_array_equal(got, slow[leaf.path])
        elif leaf.code == "f":
            assert same(float(np.float32(sent)), got)
        else:
            assert same(sent, got) and type(got) in (int, float, bool, str, bytes)


@every_message
@few
@given(data=st.data())
def test_any_damage_raises_codec_error_or_gives_a_valid_message(cls, data):
    codec = codec_for(cls)
    payload = bytearray(codec.encode(data.draw(messages(layout_of(cls)))))
    for _ in range(data.draw(st.integers(1, 4))):
        position = data.draw(st.integers(0, len(payload) - 1))
        payload[position] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(payload)))
    for damaged in (bytes(payload), bytes(payload[:cut]), bytes(payload) + bytes(1 + cut % 7)):
        try:
            msg = codec.decode(damaged)
        except CodecError:
            continue
        # Not the bytes themselves: a signalling NaN comes back as a quiet one.
        again = codec.encode(msg)
        assert len(again) == len(damaged)
        assert codec.encode(codec.decode(again)) == again


@every_message
@few
@given(junk=st.binary(max_size=200))
def test_junk_raises_codec_error(cls, junk):
    codec = codec_for(cls)
    fingerprint = layout_of(cls).fingerprint
    for payload in (junk, fingerprint + junk):
        try:
            msg = codec.decode(payload)
        except CodecError:
            continue
        assert len(codec.encode(msg)) == len(payload)


@every_message
@few
@given(data=st.data())
def test_truncated_and_extended_payloads_are_refused(cls, data):
    codec = codec_for(cls)
    payload = codec.encode(data.draw(messages(layout_of(cls))))
    cut = data.draw(st.integers(0, len(payload) - 1))
    for wrong in (payload[:cut], payload + b"\0", payload + payload):
        with pytest.raises(CodecError):
            codec.decode(wrong)


@every_message
@few
@given(data=st.data(), bad=st.sampled_from([math.nan, math.inf, -math.inf]))
def test_values_that_are_not_finite_are_refused_unless_documented(cls, data, bad):
    layout, codec = layout_of(cls), codec_for(cls)
    floats = [leaf for leaf in layout.leaves if leaf.code and leaf.code in "fd"]
    if not floats:
        return
    leaf = data.draw(st.sampled_from(floats))
    msg = data.draw(messages(layout))
    owner = attrgetter(".".join(leaf.path[:-1]))(msg) if leaf.path[:-1] else msg
    if leaf.kind == "scalar":
        setattr(owner, leaf.path[-1], bad)
    else:
        values = np.array(getattr(owner, leaf.path[-1]))
        values[data.draw(st.integers(0, leaf.count - 1))] = bad
        setattr(owner, leaf.path[-1], values)
    payload = codec.encode(msg)
    if leaf.rule.nan_ok and math.isnan(bad):
        codec.decode(payload)
        return
    with pytest.raises(CodecError) as error:
        codec.decode(payload, "SOME_CHANNEL")
    assert error.value.channel == "SOME_CHANNEL"
    assert error.value.field.split("[")[0] == leaf.name


@every_message
def test_wrong_type_is_refused_on_both_sides(cls):
    codec = codec_for(cls)
    other = header_t()
    for wrong in (other, None, 3, object()):
        with pytest.raises(CodecError):
            codec.encode(wrong)
    for wrong in (other.encode(), b"", None, 3, "text"):
        with pytest.raises(CodecError):
            codec.decode(wrong)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("joint_pos", np.zeros(28, np.float32)),
        ("joint_pos", [0.0] * 30),
        ("joint_pos", np.zeros((29, 1), np.float32)),
        ("joint_pos", ["a"] * 29),
        ("joint_pos", None),
        ("joint_pos", 3.0),
        ("motor_fault", [2**31] + [0] * 28),
        ("motor_fault", [0.5] * 29),
        ("tick", 1.5),
        ("tick", 2**63),
        ("battery_soc", "full"),
        ("wireless_remote", bytes(39)),
        ("wireless_remote", "text"),
        ("header", None),
        ("imu_pelvis", header_t()),
    ],
)
def test_wrong_field_is_named_when_encoding(field, value):
    msg = low_state()
    setattr(msg, field, value)
    with pytest.raises(CodecError) as error:
        codec_for(g1_low_state_t).encode(msg)
    assert error.value.field.startswith(field)


@pytest.mark.parametrize(
    ("make", "field", "value"),
    [
        (low_state, "joint_pos", [10.5] + [0.0] * 28),
        (low_state, "joint_vel", [0.0] * 28 + [-201.0]),
        (low_state, "joint_torque_est", [1001.0] + [0.0] * 28),
        (low_state, "battery_soc", 1.5),
        (low_state, "source", 3),
        (low_state, "imu_pelvis.quat", [0.9, 0.0, 0.0, 0.0]),
        (low_state, "imu_pelvis.quat", [0.0, 0.0, 0.0, 0.0]),
        (low_state, "imu_torso.quat", [0.0, 0.0, 0.0, 0.0]),
        (low_state, "header.utime", -1),
        (low_state, "header.seq", -1),
        (g1_low_cmd_t, "joint_stiffness", [-0.001] + [0.0] * 28),
        (g1_low_cmd_t, "joint_damping", [1.1e4] + [0.0] * 28),
        (g1_low_cmd_t, "mode", 3),
        (control_status_t, "mode", 8),
        (control_status_t, "blend_weight", 1.01),
        (music_match_t, "lock", 3),
        (skill_status_t, "source", 4),
        (operator_command_t, "command", -1),
    ],
)
def test_out_of_range_names_field_value_and_what_is_valid(make, field, value):
    msg = make()
    *owner, name = field.split(".")
    setattr(attrgetter(".".join(owner))(msg) if owner else msg, name, value)
    codec = codec_for(type(msg))
    with pytest.raises(CodecError) as error:
        codec.decode(codec.encode(msg), "CHANNEL")
    assert error.value.field.split("[")[0] == field
    assert str(error.value).startswith(f"CHANNEL.{field}")
    assert "valid is" in str(error.value)


def test_unset_fixed_byte_array_encodes_to_its_full_length():
    msg = low_state()
    msg.wireless_remote = b""
    assert len(msg.encode()) == 775 - 40  # what lcm-gen does
    payload = codec_for(g1_low_state_t).encode(msg)
    assert len(payload) == 775
    assert codec_for(g1_low_state_t).decode(payload).wireless_remote == bytes(40)


def test_torso_of_a_robot_without_one_may_be_nan():
    msg = low_state()
    for name, count in (("quat", 4), ("gyro", 3), ("accel", 3), ("rpy", 3)):
        setattr(msg.imu_torso, name, [math.nan] * count)
    codec = codec_for(g1_low_state_t)
    assert np.isnan(codec.decode(codec.encode(msg)).imu_torso.quat).all()


def test_boolean_other_than_zero_or_one_is_refused():
    codec = codec_for(music_match_t)
    payload = bytearray(codec.encode(music_match_t()))
    payload[8 + 24 + 1] = 2
    with pytest.raises(CodecError, match="accepted"):
        codec.decode(bytes(payload))


def test_text_without_zero_byte_or_of_length_zero_is_refused():
    codec = codec_for(operator_command_t)
    msg = operator_command_t()
    msg.source = "demo"
    payload = codec.encode(msg)
    with pytest.raises(CodecError, match="zero byte"):
        codec.decode(payload[:-1] + b"x")
    with pytest.raises(CodecError, match="source"):
        codec.decode(payload[:33] + struct.pack(">I", 0))
    with pytest.raises(CodecError, match="UTF-8"):
        codec.decode(payload[:-2] + b"\xff\0")


def test_length_field_must_match_the_array():
    chunk = audio_chunk_t()
    chunk.sample_rate_hz = 16000
    chunk.num_samples = 3
    chunk.samples = np.zeros(2, np.int16)
    with pytest.raises(CodecError, match="samples"):
        codec_for(audio_chunk_t).encode(chunk)
    query = transition_query_t()
    query.num_bytes = 2
    query.control_state = b"abc"
    with pytest.raises(CodecError, match="control_state"):
        codec_for(transition_query_t).encode(query)


def test_decoded_arrays_are_own_copies():
    codec = codec_for(g1_low_state_t)
    payload = codec.encode(low_state())
    first, second = codec.decode(payload), codec.decode(payload)
    first.joint_pos[0] = 1.0
    assert second.joint_pos[0] == 0.0
    assert codec.encode(second) == payload


def test_arrays_of_float64_and_slices_are_accepted():
    msg = low_state()
    expected = np.linspace(-1.0, 1.0, 29)
    msg.joint_pos = expected
    msg.joint_vel = np.zeros(58, np.float32)[::2]
    codec = codec_for(g1_low_state_t)
    back = codec.decode(codec.encode(msg))
    np.testing.assert_array_equal(back.joint_pos, expected.astype(np.float32))
