"""A robot on Cyclone DDS 0.10.2, run by another Python: the library's own path, nothing of ours
but the type definitions. Prints what it got as JSON; must end with exit code 0."""

import json
import struct
import sys
import time
import types

from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import types as idl_types
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

STOCK = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo" '
    'priority="default" multicast="default"/></Interfaces></General></Domain></CycloneDDS>'
)
"""The vendor's own configuration for an interface."""


def load_types(path):
    with open(path) as file:
        source = file.read()
    if not hasattr(idl_types, "byte"):  # 0.10 writes a uint8 as what 11 calls a byte
        source = source.replace("import array, byte,", "import uint8 as byte, array,")
    module = types.ModuleType("peer_types")
    sys.modules["peer_types"] = module
    exec(compile(source, path, "exec"), module.__dict__)
    return module


def crc_of(values):
    crc = 0xFFFFFFFF
    for word in values:
        for bit in range(31, -1, -1):
            top = crc >> 31
            crc = crc << 1 & 0xFFFFFFFF
            if top ^ (word >> bit & 1):
                crc ^= 0x04C11DB7
    return crc


def cmd_words(msg):
    fields = [msg.mode_pr, msg.mode_machine]
    for m in msg.motor_cmd:
        fields += [m.mode, m.q, m.dq, m.tau, m.kp, m.kd, m.reserve]
    image = struct.pack("<2B2x" + "B3x5fI" * 35 + "5I", *fields, *msg.reserve, msg.crc)
    return struct.unpack("<250I", image[:1000])


def state_words(msg):
    imu = msg.imu_state
    numbers = [*imu.quaternion, *imu.gyroscope, *imu.accelerometer, *imu.rpy]
    fields = [*msg.version, msg.mode_pr, msg.mode_machine, msg.tick, *numbers, imu.temperature]
    for m in msg.motor_state:
        fields += [m.mode, m.q, m.dq, m.ddq, m.tau_est, *m.temperature, m.vol, *m.sensor]
        fields += [m.motorstate, *m.reserve]
    form = "<2I2B2xI13fh2x" + "B3x4f2hf2II4I" * 35 + "40B" + "5I"
    image = struct.pack(form, *fields, *msg.wireless_remote, *msg.reserve, msg.crc)
    return struct.unpack("<522I", image[:2088])


def main():
    t = load_types(sys.argv[1])
    domain, seconds = int(sys.argv[2]), float(sys.argv[3])
    keep = Domain(domain, STOCK)
    participant = DomainParticipant(domain)
    states = DataWriter(participant, Topic(participant, "rt/lowstate", t.LowState_))
    commands = DataReader(participant, Topic(participant, "rt/lowcmd", t.LowCmd_))
    requests = DataReader(
        participant, Topic(participant, "rt/api/motion_switcher/request", t.Request_)
    )
    responses = DataWriter(
        participant, Topic(participant, "rt/api/motion_switcher/response", t.Response_)
    )
    motor = [t.MotorState_(1, 0, 0, 0, 0, [30, 30], 48, [0, 0], 0, [0] * 4) for _ in range(35)]
    imu = t.IMUState_([1, 0, 0, 0], [0] * 3, [0, 0, 9.81], [0] * 3, 30)
    remote = [85, 81] + [0] * 38
    state = t.LowState_([0, 0], 0, 5, 0, imu, motor, remote, [0] * 4, 0)
    result = {"states": 0, "commands": 0, "intact": 0, "checked": 0, "requests": 0, "kinds": []}
    active = "ai"
    end = time.monotonic() + seconds
    print("ready", flush=True)
    while time.monotonic() < end:
        state.tick += 10
        state.crc = crc_of(state_words(state))
        states.write(state)
        result["states"] += 1
        for msg in [m for m in commands.take(32) if hasattr(m, "crc")]:
            result["commands"] += 1
            if result["checked"] < 60 and result["commands"] % 3 == 0:
                result["checked"] += 1
                result["intact"] += msg.crc == crc_of(cmd_words(msg)) and msg.mode_machine == 5
            first = msg.motor_cmd[0]
            kind = "position" if first.kp else "damping" if first.kd else "zero"
            if kind not in result["kinds"]:
                result["kinds"].append(kind)
        for request in [r for r in requests.take(4) if hasattr(r, "header")]:
            result["requests"] += 1
            name = json.dumps({"name": active, "form": "0"})
            if request.header.identity.api_id == 1003:
                active, name = "", ""
            head = t.ResponseHeader_(request.header.identity, t.ResponseStatus_(0))
            responses.write(t.Response_(head, name, []))
        time.sleep(0.004)
    print(json.dumps(result), flush=True)
    del keep


main()
