"""Bytes: checksum, layout, LowCmd and LowState against the vendor's vectors and the library."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.control.bridge import layout
from downbeat.control.bridge.crc import crc32_words
from downbeat.control.bridge.lowcmd import LowCmdFrame, LowCmdView
from downbeat.control.bridge.lowstate import (
    BAD_CRC,
    BAD_ENCODING,
    BAD_IMU,
    BAD_LENGTH,
    BAD_MOTOR,
    BAD_TICK,
    StateDecoder,
)
from downbeat.control.bridge.remote import BUTTONS, buttons_of, parse_remote, remote_frame
from downbeat.control.bridge.tick_guard import TickGuard, TickVerdict
from downbeat.lcm_types import g1_low_state_t
from downbeat.runtime.codec import codec_for

ZEROS = np.zeros(29, np.float32)


def slow_crc(words):
    """The vendor's rule, bit by bit."""
    crc = 0xFFFFFFFF
    for word in words:
        for bit in range(31, -1, -1):
            top = crc >> 31 & 1
            crc = crc << 1 & 0xFFFFFFFF
            if top ^ (word >> bit & 1):
                crc ^= 0x04C11DB7
    return crc


def sealed(state):
    crc = crc32_words(layout.state_image(bytes(state)))
    state[layout.STATE_CRC] = crc.to_bytes(4, "little")
    return bytes(state)


def plain_state(tick=1, mode_machine=5):
    state = bytearray(layout.STATE_BYTES)
    state[0:4] = layout.CDR_HEAD
    state[13] = mode_machine
    struct.pack_into("<I", state, 16, tick)
    struct.pack_into("<f", state, 20, 1.0)
    return state


def test_checksum_gives_the_published_vectors():
    assert crc32_words(struct.pack("<I", 0)) == 0xC704DD7B
    assert crc32_words(struct.pack("<3I", 1, 2, 3)) == 0x64C51784


@given(st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=20))
def test_checksum_is_the_vendors_rule(words):
    assert crc32_words(struct.pack(f"<{len(words)}I", *words)) == slow_crc(words)


def test_lowcmd_gives_the_published_vectors():
    frame = bytearray(layout.CMD_BYTES)
    frame[0:4] = layout.CDR_HEAD
    assert crc32_words(layout.cmd_image(frame)) == 0xFE172F9F
    frame[5] = 5
    assert crc32_words(layout.cmd_image(frame)) == 0x54F027ED
    ours = LowCmdFrame()
    ours.set_mode_machine(5)
    q = np.float32(0.1) * np.arange(29, dtype=np.float32)
    q = np.array([np.float32(0.1 * i) for i in range(29)], np.float32)
    ours.position(q, ZEROS, ZEROS, ZEROS + 40, ZEROS + 1)
    assert int.from_bytes(ours.payload()[-4:], "little") == 0x2D82BC79


def test_lowstate_gives_the_published_vectors():
    state = bytearray(layout.STATE_BYTES)
    assert crc32_words(layout.state_image(bytes(state))) == 0xD64BB04A
    state[13] = 5
    struct.pack_into("<I", state, 16, 1)
    assert crc32_words(layout.state_image(bytes(state))) == 0xC7A85690


def test_what_lies_in_the_gaps_of_a_lowstate_does_not_enter_the_checksum():
    state = plain_state()
    clean = crc32_words(layout.state_image(bytes(state)))
    for gap in (14, 15, 75, 76 + 53, 76 + 56 * 33 + 55):
        state[gap] = 0xAA
    assert crc32_words(layout.state_image(bytes(state))) == clean


def test_our_lowcmd_is_byte_for_byte_what_the_library_writes():
    idl = pytest.importorskip("downbeat.control.bridge.idl", reason="needs cyclonedds")
    motors = [idl.MotorCmd_(0, 0, 0, 0, 0, 0, 0) for _ in range(35)]
    rng = np.random.default_rng(1)
    values = rng.normal(size=(5, 29)).astype(np.float32)
    for index in range(29):
        motors[index] = idl.MotorCmd_(1, *[float(v) for v in values[:, index]], 0)
    frame = LowCmdFrame()
    frame.set_mode_machine(5)
    frame.position(*values)
    payload = frame.payload()
    crc = int.from_bytes(payload[-4:], "little")
    assert idl.LowCmd_(0, 5, motors, [0] * 4, crc).serialize() == payload
    view = LowCmdView(payload)
    assert view.is_intact and view.mode_machine == 5 and view.modes == b"\x01" * 29
    assert np.array_equal(view.q, values[0]) and np.array_equal(view.kd, values[4])


def test_a_lowstate_of_the_library_is_read_field_by_field():
    idl = pytest.importorskip("downbeat.control.bridge.idl", reason="needs cyclonedds")
    motors = [
        idl.MotorState_(
            1, i * 0.01, i * 0.1, 9.0, i * 0.5, [30 + i, 50 + i], 48.0, [7, 8], i, [9] * 4
        )
        for i in range(35)
    ]
    imu = idl.IMUState_(
        [0.5, 0.5, 0.5, 0.5], [1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [0.25, 0.5, 0.75], 41
    )
    remote = list(range(40))
    state = idl.LowState_([1, 2], 0, 5, 1234, imu, motors, remote, [3] * 4, 0)
    decoder = StateDecoder()
    assert decoder.take(sealed(bytearray(state.serialize()))), decoder.counters
    msg = codec_for(g1_low_state_t).decode(bytes(decoder.message(77)))
    assert msg.header.utime == 77
    assert list(decoder.joint_pos) == list(msg.joint_pos)
    assert list(decoder.temperatures[1]) == list(50 + np.arange(29))
    assert list(decoder.motor_faults) == list(range(29)) and decoder.remote == bytes(range(40))
    index = np.arange(29)
    assert np.allclose(msg.joint_pos, index * 0.01) and np.allclose(msg.joint_vel, index * 0.1)
    assert np.allclose(msg.joint_torque_est, index * 0.5)
    assert list(msg.temperature_case) == list(30 + index)
    assert list(msg.temperature_winding) == list(50 + index)
    assert list(msg.motor_fault) == list(index)
    assert list(msg.imu_pelvis.quat) == [0.5] * 4 and list(msg.imu_pelvis.accel) == [4.0, 5.0, 6.0]
    assert list(msg.imu_pelvis.rpy) == [0.25, 0.5, 0.75]
    assert msg.imu_pelvis.temperature == 41 and msg.wireless_remote == bytes(remote)
    assert (msg.tick, msg.mode_machine) == (1234, 5)
    assert msg.source == g1_low_state_t.SOURCE_HARDWARE and math.isnan(msg.battery_soc)
    assert np.isnan(msg.imu_torso.quat).all() and msg.imu_torso.temperature == -1


def test_torso_imu_is_read_and_a_broken_one_is_not():
    decoder = StateDecoder()
    assert decoder.take(sealed(plain_state()))
    good = layout.CDR_HEAD + struct.pack("<13fh2x", 1, 0, 0, 0, *range(6), 1.0, 1.5, 2.0, 33)
    assert decoder.take_torso_imu(good)
    torso = codec_for(g1_low_state_t).decode(bytes(decoder.message(1))).imu_torso
    assert list(torso.gyro) == [0.0, 1.0, 2.0] and list(torso.rpy) == [1.0, 1.5, 2.0]
    assert torso.temperature == 33
    assert not decoder.take_torso_imu(good[:40])
    assert not decoder.take_torso_imu(layout.CDR_HEAD + struct.pack("<13fh2x", *[math.nan] * 13, 0))
    decoder.forget_torso_imu()
    torso = codec_for(g1_low_state_t).decode(bytes(decoder.message(1))).imu_torso
    assert np.isnan(torso.quat).all() and torso.temperature == -1


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda s: s.__setitem__(200, s[200] ^ 1), BAD_CRC),
        (lambda s: s.__delitem__(slice(1000, None)), BAD_LENGTH),
        (lambda s: s.clear(), BAD_LENGTH),
        (lambda s: s.__setitem__(1, 0), BAD_ENCODING),
    ],
)
def test_a_damaged_state_is_counted_named_and_not_passed_on(damage, reason):
    decoder = StateDecoder()
    assert decoder.take(sealed(plain_state(tick=1)))
    state = bytearray(sealed(plain_state(tick=2)))
    damage(state)
    assert not decoder.take(bytes(state))
    assert decoder.counters.rejected == {reason: 1} and reason in decoder.counters.last_reason
    assert codec_for(g1_low_state_t).decode(bytes(decoder.message(1))).tick == 1


@pytest.mark.parametrize(
    ("offset", "value", "reason"),
    [
        (76, math.nan, BAD_MOTOR),
        (76 + 28 * 56, math.inf, BAD_MOTOR),
        (80, 300.0, BAD_MOTOR),
        (20, math.nan, BAD_IMU),
        (20, 0.5, BAD_IMU),
        (36, math.nan, BAD_IMU),
    ],
)
def test_a_state_with_a_true_checksum_and_a_false_number_is_not_passed_on(offset, value, reason):
    decoder = StateDecoder()
    state = plain_state()
    struct.pack_into("<f", state, offset, value)
    assert not decoder.take(sealed(state))
    assert decoder.counters.rejected == {reason: 1}


def test_another_robot_is_refused_by_name():
    decoder = StateDecoder()
    assert not decoder.take(sealed(plain_state(mode_machine=2)))
    assert decoder.counters.last_reason == (
        "wrong mode_machine: 2 (29 dof), valid is 5 (29 dof rev 1.0)"
    )


def test_angles_that_a_simulator_leaves_out_are_those_of_the_quaternion():
    state = plain_state()
    struct.pack_into("<4f", state, 20, 0.5, 0.5, 0.5, 0.5)
    decoder = StateDecoder(lenient=True)
    assert decoder.take(sealed(state))
    msg = codec_for(g1_low_state_t).decode(bytes(decoder.message(1)))
    assert np.allclose(msg.imu_pelvis.rpy, [math.pi / 2, 0.0, math.pi / 2], atol=1e-3)


def test_zeros_mean_not_filled_in_for_simulators_only():
    unfilled = bytes(plain_state(tick=0, mode_machine=0))
    assert not StateDecoder().take(unfilled)
    lenient = StateDecoder(lenient=True)
    assert all(lenient.take(unfilled) for _ in range(5))
    assert lenient.counters.lost == 0


def test_a_tick_that_goes_backwards_is_never_passed_on():
    decoder = StateDecoder()
    assert decoder.take(sealed(plain_state(tick=100)))
    for tick in (100, 98, 2):
        assert not decoder.take(sealed(plain_state(tick=tick)))
    assert decoder.counters.rejected == {BAD_TICK: 3}
    assert decoder.take(sealed(plain_state(tick=102)))


@pytest.mark.parametrize("step", [1, 2, 5])
def test_gaps_are_counted_in_the_robots_own_steps(step):
    guard = TickGuard()
    ticks = [step * i for i in range(1, 400)]
    missing = (200, 201, 300)
    for index, tick in enumerate(ticks):
        if index not in missing:
            assert guard.judge(tick) is TickVerdict.GOOD
    assert guard.lost == len(missing)


def test_a_robot_that_was_restarted_is_believed_after_a_tenth_of_a_second():
    guard = TickGuard()
    for tick in range(100_000, 101_000, 2):
        guard.judge(tick)
    verdicts = [guard.judge(tick) for tick in range(2, 202, 2)]
    assert verdicts[:49] == [TickVerdict.BACKWARDS] * 49
    assert verdicts[49] is TickVerdict.RESTARTED
    assert set(verdicts[50:]) == {TickVerdict.GOOD}


@given(st.sets(st.sampled_from(BUTTONS)), st.floats(-1, 1, width=32), st.floats(-1, 1, width=32))
def test_remote_frames_are_read_as_they_are_written(pressed, x, y):
    frame = remote_frame(tuple(pressed), (x, y), (y, x))
    remote = parse_remote(frame)
    assert remote.left_stick == (x, y) and remote.right_stick == (y, x)
    assert {name for bit, name in enumerate(BUTTONS) if remote.buttons >> bit & 1} == pressed
    assert buttons_of(frame) == remote.buttons


@given(st.binary(max_size=2200))
def test_no_bytes_raise(payload):
    decoder = StateDecoder(lenient=True)
    decoder.take(payload)
    decoder.take(layout.CDR_HEAD + payload.ljust(layout.STATE_BYTES - 4, b"\x00")[:2088])
    decoder.take_torso_imu(payload)
    assert decoder.counters.rejected
