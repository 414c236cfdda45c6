"""The G1's DDS types, in our own words; needs the extra `g1` (cyclonedds).

What Unitree's IDL calls uint8 is `byte` here. Cyclone DDS 0.10, which the robot's own programs use,
describes an IDL uint8 as TK_BYTE; 11.x describes it as TK_UINT8, and a 0.10 program that reads such
a description ends with SIGSEGV (measured). With `byte` both write the same description.

Field names and their order are the wire contract: they enter the type's hash.
"""

# No `from __future__ import annotations` here: cyclonedds resolves annotations by itself.
from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import autoid, final
from cyclonedds.idl.types import array, byte, float32, int16, int32, int64, sequence, uint16, uint32

NUM_SLOTS = 35
"""Motor slots in a message; the G1 uses the first 29."""


@dataclass
@final
@autoid("sequential")
class MotorCmd_(IdlStruct, typename="unitree_hg.msg.dds_.MotorCmd_"):
    """One motor's command: mode 1 enable; q [rad], dq [rad/s], tau [N m], kp, kd."""

    mode: byte
    q: float32
    dq: float32
    tau: float32
    kp: float32
    kd: float32
    reserve: uint32


@dataclass
@final
@autoid("sequential")
class LowCmd_(IdlStruct, typename="unitree_hg.msg.dds_.LowCmd_"):
    """Topic rt/lowcmd."""

    mode_pr: byte
    mode_machine: byte
    motor_cmd: array[MotorCmd_, NUM_SLOTS]
    reserve: array[uint32, 4]
    crc: uint32


@dataclass
@final
@autoid("sequential")
class IMUState_(IdlStruct, typename="unitree_hg.msg.dds_.IMUState_"):
    """Quaternion wxyz, [rad/s], [m/s^2], [rad], [deg C]; also topic rt/secondary_imu."""

    quaternion: array[float32, 4]
    gyroscope: array[float32, 3]
    accelerometer: array[float32, 3]
    rpy: array[float32, 3]
    temperature: int16


@dataclass
@final
@autoid("sequential")
class MotorState_(IdlStruct, typename="unitree_hg.msg.dds_.MotorState_"):
    """One motor: [rad], [rad/s], [rad/s^2], [N m]; temperature casing, winding [deg C]."""

    mode: byte
    q: float32
    dq: float32
    ddq: float32
    tau_est: float32
    temperature: array[int16, 2]
    vol: float32
    sensor: array[uint32, 2]
    motorstate: uint32
    reserve: array[uint32, 4]


@dataclass
@final
@autoid("sequential")
class LowState_(IdlStruct, typename="unitree_hg.msg.dds_.LowState_"):
    """Topic rt/lowstate."""

    version: array[uint32, 2]
    mode_pr: byte
    mode_machine: byte
    tick: uint32
    imu_state: IMUState_
    motor_state: array[MotorState_, NUM_SLOTS]
    wireless_remote: array[byte, 40]
    reserve: array[uint32, 4]
    crc: uint32


@dataclass
@final
@autoid("sequential")
class BmsState_(IdlStruct, typename="unitree_hg.msg.dds_.BmsState_"):
    """Topic rt/lf/bmsstate: the battery; soc in percent."""

    version_high: byte
    version_low: byte
    fn: byte
    cell_vol: array[uint16, 40]
    bmsvoltage: array[uint32, 3]
    current: int32
    soc: byte
    soh: byte
    temperature: array[int16, 12]
    cycle: uint16
    manufacturer_date: uint16
    bmsstate: array[uint32, 5]
    reserve: array[uint32, 3]


@dataclass
@final
@autoid("sequential")
class RequestIdentity_(IdlStruct, typename="unitree_api.msg.dds_.RequestIdentity_"):
    """Which call of which function."""

    id: int64
    api_id: int64


@dataclass
@final
@autoid("sequential")
class RequestLease_(IdlStruct, typename="unitree_api.msg.dds_.RequestLease_"):
    """Exclusive use of a service; 0: none."""

    id: int64


@dataclass
@final
@autoid("sequential")
class RequestPolicy_(IdlStruct, typename="unitree_api.msg.dds_.RequestPolicy_"):
    """Priority, and whether no answer is wanted."""

    priority: int32
    noreply: bool


@dataclass
@final
@autoid("sequential")
class RequestHeader_(IdlStruct, typename="unitree_api.msg.dds_.RequestHeader_"):
    """Head of a request."""

    identity: RequestIdentity_
    lease: RequestLease_
    policy: RequestPolicy_


@dataclass
@final
@autoid("sequential")
class Request_(IdlStruct, typename="unitree_api.msg.dds_.Request_"):
    """Topic rt/api/SERVICE/request; `parameter` is JSON."""

    header: RequestHeader_
    parameter: str
    binary: sequence[byte]


@dataclass
@final
@autoid("sequential")
class ResponseStatus_(IdlStruct, typename="unitree_api.msg.dds_.ResponseStatus_"):
    """0: good."""

    code: int32


@dataclass
@final
@autoid("sequential")
class ResponseHeader_(IdlStruct, typename="unitree_api.msg.dds_.ResponseHeader_"):
    """Head of an answer."""

    identity: RequestIdentity_
    status: ResponseStatus_


@dataclass
@final
@autoid("sequential")
class Response_(IdlStruct, typename="unitree_api.msg.dds_.Response_"):
    """Topic rt/api/SERVICE/response; `data` is JSON."""

    header: ResponseHeader_
    data: str
    binary: sequence[byte]
