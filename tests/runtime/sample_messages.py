"""Small valid messages for tests."""

from downbeat.lcm_types import g1_low_state_t, skill_request_t
from downbeat.runtime.clock import SIM_EPOCH_UTIME


def low_state(utime=SIM_EPOCH_UTIME):
    msg = g1_low_state_t()
    msg.header.utime = utime
    msg.imu_pelvis.quat = [1.0, 0.0, 0.0, 0.0]
    msg.imu_torso.quat = [1.0, 0.0, 0.0, 0.0]
    return msg


def request(number=1):
    msg = skill_request_t()
    msg.request_id = number
    msg.skill = "armwave"
    return msg
