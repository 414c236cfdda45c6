"""The tick: modes, faults, requests and their answers."""

import numpy as np
import pytest
from control_rig import Rig

from downbeat.control import faults
from downbeat.control.errors import ControlError
from downbeat.lcm_types import (
    control_status_t,
    estop_t,
    g1_low_cmd_t,
    operator_command_t,
    skill_request_t,
)


def estop(level=estop_t.DAMP):
    msg = estop_t()
    msg.level, msg.source, msg.reason = level, "test", "why not"
    return msg


def operator(command):
    msg = operator_command_t()
    msg.command = command
    return msg


def test_robot_stands_by_itself_in_simulation(rig):
    assert rig.log[-1].status.mode == control_status_t.STAND
    assert rig.log[-1].command.mode == g1_low_cmd_t.MODE_POSITION


def test_robot_waits_for_the_operator_on_hardware(library):
    rig = Rig(library)
    for _ in range(10):
        state = rig.state()
        state.source = 1
        output = rig.tick(state=state)
        assert output.command.mode == g1_low_cmd_t.MODE_ZERO_TORQUE
    state = rig.state()
    state.source = 1
    rig.tick(state=state, operator=(operator(operator_command_t.ARM),))
    assert rig.core.mode in (control_status_t.MOVE_TO_POSE, control_status_t.STAND)


def test_estop_damps_at_once_and_stays_until_cleared(rig):
    output = rig.tick(estops=(estop(),))
    assert output.command.mode == g1_low_cmd_t.MODE_DAMPING
    assert output.status.mode == control_status_t.ESTOP
    assert output.status.fault == ROWS["estop"].id
    rig.run(0.5)
    assert rig.log[-1].command.mode == g1_low_cmd_t.MODE_DAMPING
    rig.tick(operator=(operator(operator_command_t.ARM),))
    assert rig.log[-1].command.mode == g1_low_cmd_t.MODE_DAMPING
    rig.tick(operator=(operator(operator_command_t.CLEAR_TRIP),))
    rig.tick(operator=(operator(operator_command_t.ARM),))
    rig.run(0.2)
    assert rig.log[-1].status.mode == control_status_t.STAND


def test_estop_can_make_the_robot_limp(rig):
    output = rig.tick(estops=(estop(estop_t.ZERO_TORQUE),))
    assert output.status.mode == control_status_t.ESTOP
    assert output.command.mode == g1_low_cmd_t.MODE_ZERO_TORQUE
    rig.tick(operator=(operator(operator_command_t.CLEAR_TRIP),))
    assert rig.log[-1].command.mode == g1_low_cmd_t.MODE_DAMPING


def test_operator_can_end_everything_in_stand(rig):
    rig.tick(requests=(rig.request("kpop"), rig.request("wave", 3.0)))
    rig.run(1.5)
    rig.tick(operator=(operator(operator_command_t.STAND),))
    rig.run(2.0)
    assert rig.states_of(1)[-1] == rig.states_of(2)[-1] == "ABORTED"
    assert rig.log[-1].status.skill == "stand"


def test_estop_aborts_what_runs_and_what_waits(rig):
    rig.tick(requests=(rig.request("kpop"), rig.request("thriller", 5.0)))
    rig.run(1.0)
    rig.tick(estops=(estop(),))
    assert rig.states_of(1)[-1] == "ABORTED"
    assert rig.states_of(2)[-1] == "ABORTED"


DAMPING_CASES = {
    "state_stale": {"age_us": 90_000},
    "state_ahead": {"age_us": -200_000},
    "tilt": {"quat": (0.8, 0.6, 0.0, 0.0)},
    "joint_range": {"joint": 3.5},
    "joint_speed": {"speed": 120.0},
    "motor_fault": {"motor": 4},
    "motor_hot": {"winding": 110},
    "battery_empty": {"charge": 0.03},
    "second_publisher": {"foreign": True},
}
STAND_CASES = {
    "motor_warm": {"winding": 90},
    "battery_low": {"charge": 0.15},
    "torque_saturated": {"torque": 500.0},
}
ROWS = {row.name: row for row in faults.FAULTS}


def spoiled(rig, spoil):
    state = rig.state()
    if "quat" in spoil:
        state.imu_pelvis.quat = np.array(spoil["quat"], np.float32)
    if "joint" in spoil:
        state.joint_pos[3] = spoil["joint"]
    if "speed" in spoil:
        state.joint_vel[3] = spoil["speed"]
    if "torque" in spoil:
        state.joint_torque_est[3] = spoil["torque"]
    if "motor" in spoil:
        state.motor_fault[7] = spoil["motor"]
    if "winding" in spoil:
        state.temperature_winding[7] = spoil["winding"]
    if "charge" in spoil:
        state.battery_soc = spoil["charge"]
    return state


@pytest.mark.parametrize("name", DAMPING_CASES)
def test_fault_leads_to_damping_and_is_latched(rig, name):
    spoil, fault = DAMPING_CASES[name], ROWS[name]
    for k in range(fault.raise_after_ticks):
        output = rig.tick(
            state=spoiled(rig, spoil),
            age_us=spoil.get("age_us", 0),
            foreign_states=k + 1 if "foreign" in spoil else 0,
        )
    assert output.status.fault == fault.id, output.status.fault_text
    assert output.command.mode == g1_low_cmd_t.MODE_DAMPING
    rig.run(0.2)
    assert rig.log[-1].command.mode == g1_low_cmd_t.MODE_DAMPING


@pytest.mark.parametrize("name", STAND_CASES)
def test_fault_ends_the_dance_in_stand_and_refuses_others(rig, name):
    rig.tick(requests=(rig.request("kpop"),))
    rig.run(1.5)
    assert rig.log[-1].status.skill == "kpop"
    for _ in range(120):
        output = rig.tick(state=spoiled(rig, STAND_CASES[name]))
    assert output.status.fault == ROWS[name].id
    assert output.status.skill == "stand"
    assert output.command.mode == g1_low_cmd_t.MODE_POSITION
    assert rig.states_of(1)[-1] == "ABORTED"
    rig.tick(state=spoiled(rig, STAND_CASES[name]), requests=(rig.request("wave"),))
    assert rig.states_of(2)[-1] == "REFUSED"
    rig.run(11.0)
    rig.tick(requests=(rig.request("wave"),))
    rig.run(2.0)
    assert rig.log[-1].status.skill == "wave"


def test_time_that_steps_leads_to_damping(rig):
    rig.now += 5_000_000
    assert rig.tick().status.fault == ROWS["clock_step"].id
    assert rig.log[-1].command.mode == g1_low_cmd_t.MODE_DAMPING


def test_lost_remote_leads_to_damping_on_hardware(library):
    rig = Rig(library)

    def tick(remote):
        state = rig.state()
        state.source = 1
        state.wireless_remote = bytes(40) if not remote else bytes([1] * 40)
        return rig.tick(state=state, operator=inputs)

    inputs = (operator(operator_command_t.ARM),)
    tick(True)
    inputs = ()
    for _ in range(145):
        assert tick(False).command.mode == g1_low_cmd_t.MODE_POSITION
    for _ in range(10):
        output = tick(False)
    assert output.status.fault == ROWS["remote_lost"].id
    assert output.command.mode == g1_low_cmd_t.MODE_DAMPING


def test_late_state_is_reported_but_the_dance_goes_on(rig):
    output = rig.tick(age_us=50_000)
    assert output.status.fault == ROWS["state_late"].id
    assert output.command.mode == g1_low_cmd_t.MODE_POSITION


class Broken:
    """A skill whose targets are spoiled."""

    def __init__(self, skill, value):
        self.manifest = skill.manifest
        self._skill, self._value = skill, value

    def begin(self, state, phase_s):
        return self._skill.begin(state, phase_s)

    def step(self, memory, state, phase_s, command):
        output = self._skill.step(memory, state, phase_s, command)
        output.targets.joint_pos[5] = self._value
        return output


@pytest.mark.parametrize(
    ("value", "name"),
    [
        (np.nan, "non_finite_action"),
        (np.inf, "non_finite_action"),
        (1e9, "action_range"),
        (-1e9, "action_range"),
    ],
)
def test_bad_action_is_never_sent_and_the_robot_stands(rig, value, name):
    rig.tick(requests=(rig.request("kpop"),))
    rig.run(1.5)
    playback = rig.core.director.playback
    playback.skill = Broken(playback.skill, value)
    output = rig.tick()
    assert output.status.fault == ROWS[name].id
    assert output.status.mode == control_status_t.FALLBACK
    assert output.command.mode == g1_low_cmd_t.MODE_POSITION
    assert np.abs(output.command.joint_pos_target).max() < 3.0
    assert rig.states_of(1)[-1] == "ABORTED"
    rig.run(2.0)
    assert rig.log[-1].status.mode == control_status_t.STAND


def test_observation_that_is_not_finite_hands_over_in_the_same_tick(rig):
    rig.tick(requests=(rig.request("kpop"),))
    rig.run(1.5)
    playback = rig.core.director.playback

    class Blind(Broken):
        def step(self, memory, state, phase_s, command):
            output = self._skill.step(memory, state, phase_s, command)
            output.obs[7] = self._value
            return output

    playback.skill = Blind(playback.skill, np.nan)
    output = rig.tick()
    assert output.status.fault == ROWS["non_finite_observation"].id
    assert output.status.mode == control_status_t.FALLBACK
    assert output.command.mode == g1_low_cmd_t.MODE_POSITION


def test_broken_balance_policy_leads_to_damping(rig, monkeypatch):
    playback = rig.core.director.playback
    library = rig.core.director.library
    playback.skill = Broken(playback.skill, np.nan)
    broken = {**library._skills, "stand": Broken(library["stand"], np.nan)}
    monkeypatch.setattr(library, "_skills", broken)
    output = rig.tick()
    assert output.status.fault == ROWS["fallback_failed"].id
    assert output.command.mode == g1_low_cmd_t.MODE_DAMPING
    assert np.isfinite(output.command.joint_pos_target).all()


def test_every_fault_has_its_own_number():
    assert len({fault.id for fault in faults.FAULTS}) == len(faults.FAULTS)


def test_planted_skill_begins_exactly_at_the_asked_time(rig):
    request = rig.request("kpop", 2.0)
    rig.tick(requests=(request,))
    rig.run(4.0)
    assert abs(rig.onset_utime("kpop") - request.start_utime) <= 10_000
    assert rig.states_of(1) == ["QUEUED", "BLENDING", "RUNNING"]


def test_skill_enters_in_the_phase_that_was_asked_for(rig):
    request = rig.request("kpop", 1.0, start_phase_s=2.5, phase_rate=1.1)
    rig.tick(requests=(request,))
    rig.run(3.0)
    for output in rig.log:
        if output.status.skill == "kpop":
            elapsed_s = (output.status.header.utime - request.start_utime) * 1e-6
            assert output.status.phase_s == pytest.approx((2.5 + 1.1 * elapsed_s) % 8.0, abs=1e-6)


def test_footwork_is_entered_from_stand_at_phase_zero(rig):
    rig.tick(requests=(rig.request("kpop"),))
    rig.run(1.5)
    request = rig.request("discostep", 4.0)
    rig.tick(requests=(request,))
    rig.run(6.0)
    assert abs(rig.onset_utime("discostep") - request.start_utime) <= 20_000
    first = next(o.status for o in rig.log if o.status.skill == "discostep")
    assert first.previous_skill == "stand"
    at_onset = next(
        o.status for o in rig.log if o.status.skill == "discostep" and o.status.blend_weight >= 0.5
    )
    assert at_onset.phase_s == pytest.approx(0.0, abs=0.021)


def test_footwork_is_left_only_at_an_exit_phase(rig, library):
    manifest = library["discostep"].manifest
    rig.tick(requests=(rig.request("discostep"),))
    rig.run(3.3)
    rig.tick(requests=(rig.request("kpop"),))
    rig.run(6.0)
    statuses = [o.status for o in rig.log]
    index = next(i for i, s in enumerate(statuses) if s.previous_skill == "discostep")
    left_at = statuses[index - 1].phase_s + 0.02
    away = [
        abs(
            (left_at - e + 0.5 * manifest.duration_s) % manifest.duration_s
            - 0.5 * manifest.duration_s
        )
        for e in manifest.exit_phases_s
    ]
    assert min(away) <= 0.021
    assert statuses[index].skill == "stand"
    assert rig.states_of(2) == ["QUEUED", "PRIMING", "BLENDING", "RUNNING"]


def test_stand_phase_ends_on_an_announced_boundary(rig):
    rig.tick(requests=(rig.request("discostep"),))
    rig.run(1.0)
    request = rig.request("thriller", 8.0)
    rig.tick(requests=(request,))
    rig.run(9.0)
    assert abs(rig.onset_utime("thriller") - request.start_utime) <= 20_000


def test_cancelled_request_never_starts(rig):
    rig.tick(requests=(rig.request("kpop", 2.0),))
    cancel = rig.request("", operation=skill_request_t.CANCEL, target_request_id=1, cause="no")
    rig.tick(requests=(cancel,))
    rig.run(4.0)
    assert rig.states_of(1) == ["QUEUED", "CANCELLED"]
    assert all(o.status.skill == "stand" for o in rig.log[20:])


def test_expired_request_is_dropped_with_a_reason(rig):
    request = rig.request("kpop", 2.0, expires_utime=rig.now + 500_000)
    rig.tick(requests=(request,))
    rig.run(3.0)
    assert rig.states_of(1) == ["QUEUED", "EXPIRED"]
    assert any("in time" in change.reason for change in rig.changes)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"skill": "moonwalk"}, "skills are discostep, kpop"),
        ({"request_id": 0}, "ids are > 0"),
        ({"phase_rate": 9.0}, "outside 0.25..4.0"),
        ({"expires_utime": 5}, "expired"),
    ],
)
def test_wrong_request_is_refused_in_one_sentence(rig, fields, reason):
    request = rig.request("kpop")
    for name, value in fields.items():
        setattr(request, name, value)
    output = rig.tick(requests=(request,))
    (change,) = output.changes
    assert reason in change.reason
    rig.run(0.5)
    assert rig.log[-1].status.skill == "stand"


def test_doubled_request_id_is_refused(rig):
    request = rig.request("kpop", 3.0)
    rig.tick(requests=(request, request))
    assert rig.states_of(1) == ["QUEUED", "REFUSED"]


def test_music_cannot_overrule_the_operator(rig):
    rig.tick(requests=(rig.request("kpop", source=0, priority=10),))
    rig.run(1.0)
    rig.tick(requests=(rig.request("thriller"),))
    assert rig.states_of(2) == ["REFUSED"]


def test_duration_ends_in_stand(rig):
    rig.tick(requests=(rig.request("kpop", duration_s=2.0),))
    rig.run(4.0)
    assert rig.states_of(1)[-1] == "DONE"
    assert rig.log[-1].status.skill == "stand"


def test_one_shot_gesture_ends_in_stand(rig):
    rig.tick(requests=(rig.request("wave"),))
    rig.run(6.0)
    assert rig.states_of(1)[-1] == "DONE"
    assert rig.log[-1].status.skill == "stand"


def test_retime_moves_the_phase_without_a_jump(rig):
    rig.tick(requests=(rig.request("kpop"),))
    rig.run(1.0)
    status = rig.log[-1].status
    retime = rig.request("kpop", operation=skill_request_t.RETIME, target_request_id=1)
    retime.start_phase_s = status.phase_s + 0.02 + 0.1  # a tenth of a second ahead
    rig.tick(requests=(retime,))
    before = rig.log[-1].status.phase_s
    for _ in range(200):
        after = rig.tick().status
        step = (after.phase_s - before) % 8.0
        assert 0.0 < step < 0.02 * 1.12
        before = after.phase_s
    line = retime.start_phase_s + (after.header.utime - retime.start_utime) * 1e-6
    assert (line - after.phase_s + 4.0) % 8.0 - 4.0 == pytest.approx(0.0, abs=2e-3)


def test_walk_starts_stops_and_returns_to_stand(rig):
    rig.tick(requests=(rig.request("walk", velocity=(0.2, 0.0, 0.0), duration_s=3.0),))
    rig.run(2.5)
    assert rig.log[-1].status.skill == "walk"
    assert rig.core.director.playback.velocity.current[0] == pytest.approx(0.2, abs=0.01)
    rig.run(6.0)
    assert rig.log[-1].status.skill == "stand"


def test_interrupted_route_prefers_the_successor(rig):
    """A cancelled successor leaves the robot in stand for a moment, not back in the old dance."""
    rig.tick(requests=(rig.request("kpop"),))
    rig.run(1.0)
    rig.tick(requests=(rig.request("discostep", 2.0),))
    rig.run(1.3)
    rig.tick(requests=(rig.request("", operation=1, target_request_id=2),))
    rig.run(0.5)
    rig.tick(requests=(rig.request("thriller"),))
    rig.run(1.0)
    assert rig.log[-1].status.skill == "thriller"


def test_same_inputs_give_the_same_bits(library):
    def play():
        rig = Rig(library)
        rig.run(0.2)
        rig.tick(requests=(rig.request("kpop"),))
        rig.run(2.0)
        rig.tick(requests=(rig.request("zombie"),))
        rig.run(4.0)
        return [(o.status.obs_hash, o.status.action_hash, o.status.command_hash) for o in rig.log]

    assert play() == play()


@pytest.mark.parametrize("after_s", [0.1, 0.8, 1.06, 2.3, 3.1])
def test_snapshot_restores_control_exactly(library, after_s):
    """A restored core and the original answer the same inputs with the same bits."""
    rig = Rig(library)
    rig.run(0.2)
    rig.tick(requests=(rig.request("kpop", 0.5), rig.request("zombie", 2.0)))
    rig.run(after_s)
    data = rig.core.snapshot()
    other = Rig(library)
    other.core.restore(data)
    assert other.core.snapshot() == data
    other.now, other.tick_number = rig.now, rig.tick_number
    rig.log.clear()
    for one in (rig, other):
        one.run(3.0)
        one.tick(requests=(one.request("walk", velocity=(0.2, 0, 0), request_id=9),))
        one.run(3.0)
    for ours, theirs in zip(rig.log, other.log, strict=True):
        assert ours.status.obs_hash == theirs.status.obs_hash
        assert ours.status.command_hash == theirs.status.command_hash
        assert ours.status.skill == theirs.status.skill


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{}",
        b"[]",
        b"\xff\xfe",
        b'{"snapshot":1,"state":{"x":{"!":"Popen","v":[]}}}',
        b"1" * 9,
    ],
)
def test_bytes_that_are_no_snapshot_are_refused(rig, data):
    with pytest.raises(ControlError, match="snapshot"):
        rig.core.restore(data)
