"""The robot's services: requests and answers as bytes, the motion switcher, the voice."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from downbeat.control.bridge.lights import Lights
from downbeat.control.bridge.motion_service import MotionService
from downbeat.control.bridge.rpc import (
    NO_ANSWER,
    Answer,
    Service,
    decode_request,
    decode_response,
    encode_request,
    encode_response,
)
from downbeat.control.bridge.stages import Stage
from downbeat.control.bridge.voice import CHUNK_BYTES, LIGHTS, RobotSpeaker
from downbeat.control.errors import ControlError
from downbeat.lcm_types import control_status_t, speech_t
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SimClock
from downbeat.sim.fake_services import FakeMotionSwitcher, FakeVoice, ServiceHost


class Wire:
    """A topic between two ends of a test; keeps the last sample only, as a default reader does."""

    def __init__(self, depth=1):
        self._depth, self._samples = depth, []

    def write(self, payload):
        self._samples = [*self._samples, payload][-self._depth :]

    def take(self):
        samples, self._samples = self._samples, []
        return samples


class Pair:
    """A service of ours and the fake that answers it, on a clock of the test's."""

    def __init__(self, fake):
        self.now = 100.0
        requests, self.responses = Wire(), Wire()
        self.service = Service(requests, self.responses, 1.0, lambda: self.now)
        self.host = ServiceHost(fake, requests, self.responses)

    def run(self, seconds, *each):
        for _ in range(round(seconds / 0.1)):
            self.now += 0.1
            for one in each:
                one(round(self.now * 1e6))
            self.host.serve()


def test_requests_and_answers_are_byte_for_byte_the_librarys():
    idl = pytest.importorskip("downbeat.control.bridge.idl", reason="needs cyclonedds")
    head = idl.RequestHeader_(
        idl.RequestIdentity_(7, 1001), idl.RequestLease_(0), idl.RequestPolicy_(0, False)
    )
    for text, data in (("{}", b""), ('{"a": 1}', bytes(range(5))), ("", b"1234")):
        theirs = idl.Request_(head, text, list(data)).serialize()
        ours = encode_request(7, 1001, text, data)
        assert ours[: len(theirs)] == theirs and len(ours) % 4 == 0
        assert decode_request(theirs) == (7, 1001, text, data)
        answer = idl.Response_(
            idl.ResponseHeader_(idl.RequestIdentity_(7, 1001), idl.ResponseStatus_(-3)), text, []
        ).serialize()
        assert encode_response(7, 1001, -3, text)[: len(answer)] == answer
        assert decode_response(answer).code == -3


@given(st.binary(max_size=100))
def test_damaged_answers_are_counted_and_never_raise(payload):
    responses = Wire()
    service = Service(Wire(), responses, 1.0, lambda: 1.0)
    responses.write(payload)
    assert service.poll() == []


def test_an_answer_to_somebody_else_is_not_ours_and_none_is_an_answer_too():
    pair = Pair(FakeMotionSwitcher())
    call = pair.service.call(1001)
    pair.responses.write(encode_response(call + 5, 1001, 0, "{}"))
    assert pair.service.poll() == []
    pair.now += 1.1
    assert pair.service.poll() == [Answer(call, 1001, NO_ANSWER, {})]


def test_requests_that_follow_each_other_at_once_all_arrive():
    fake = FakeVoice()
    pair = Pair(fake)
    for volume in (10, 20, 30):
        pair.service.call(1006, {"volume": volume})
    pair.service.call(1010, {"R": 1, "G": 2, "B": 3})
    pair.run(1.5, lambda _: pair.service.poll())
    assert fake.record.volume == 30 and fake.record.lights == [(1, 2, 3)]


def test_motion_service_lets_go_even_when_the_first_request_changes_nothing():
    fake = FakeMotionSwitcher("ai", refusals=2)
    pair = Pair(fake)
    motion = MotionService(pair.service, may_be_absent=False)
    pair.run(2.0, lambda t: motion.update(t, release=False))
    assert motion.active == "ai" == fake.active  # not without the operator's word
    pair.run(6.0, lambda t: motion.update(t, release=True))
    assert motion.active == "" == fake.active


@pytest.mark.parametrize(("may_be_absent", "active"), [(True, ""), (False, None)])
def test_a_missing_motion_service_is_fine_in_simulation_only(may_be_absent, active):
    now = [0.0]
    service = Service(Wire(), Wire(), 1.0, lambda: now[0])
    motion = MotionService(service, may_be_absent)
    for tenth in range(80):
        now[0] = tenth * 0.1
        motion.update(round(now[0] * 1e6), release=False)
    assert motion.active == active


def test_speech_goes_out_in_chunks_a_second_apart_and_whole():
    fake = FakeVoice()
    pair = Pair(fake)
    speaker = RobotSpeaker(pair.service)
    samples = np.arange(3 * CHUNK_BYTES // 2 + 100, dtype=np.int64).astype(np.int16)
    assert speaker.play(samples, round(pair.now * 1e6)) == len(samples) / 16_000
    sizes = []
    pair.run(0.5, speaker.update)
    sizes.append(len(fake.record.pcm))
    pair.run(1.0, speaker.update)
    sizes.append(len(fake.record.pcm))
    assert sizes == [CHUNK_BYTES, 2 * CHUNK_BYTES]
    pair.run(4.0, speaker.update)
    assert bytes(fake.record.pcm) == samples.tobytes()
    assert fake.record.streams == ["downbeat/1"] and speaker.errors == {}
    assert speaker.is_playing(round(pair.now * 1e6))  # 9 s of sound, 5.5 s have passed


def test_a_new_sound_stops_the_old_one():
    fake = FakeVoice()
    pair = Pair(fake)
    speaker = RobotSpeaker(pair.service)
    speaker.play(np.zeros(160_000, np.int16), round(pair.now * 1e6))
    pair.run(0.3, speaker.update)
    speaker.play(np.ones(1600, np.int16), round(pair.now * 1e6))
    pair.run(2.0, speaker.update)
    assert fake.record.stops == 1 and fake.record.streams == ["downbeat/1", "downbeat/2"]
    assert len(fake.record.pcm) == CHUNK_BYTES + 3200


def test_volume_and_sound_are_checked_before_they_are_sent():
    speaker = RobotSpeaker(Pair(FakeVoice()).service)
    with pytest.raises(ControlError, match="0 to 1"):
        speaker.set_volume(1.5)
    with pytest.raises(ControlError, match="one row of int16"):
        speaker.play(np.zeros((2, 10), np.int16), 0)


def test_a_voice_that_refuses_is_counted_by_code():
    pair = Pair(FakeVoice())
    speaker = RobotSpeaker(pair.service)
    pair.service.call(9999)
    pair.run(0.4, speaker.update)
    pair.service.call(1006, {"volume": 500})
    pair.run(0.4, speaker.update)
    assert speaker.errors == {3203: 1, 100: 1}


class Core:
    stage = Stage.ACTIVE


def test_light_shows_what_the_robot_does_once_per_change():
    fake = FakeVoice()
    pair = Pair(fake)
    clock = SimClock(100_000_000)
    hub = MemqHub()
    ends = {name: hub.endpoint(name, clock) for name in ("bridge", "control", "speech")}
    core = Core()
    lights = Lights(ends["bridge"], core, RobotSpeaker(pair.service))

    def tick(utime):
        clock.advance_to(utime)
        ends["bridge"].pump()
        lights(utime)

    def say(mode=None, speech=None):
        if mode is not None:
            msg = control_status_t()
            msg.header.utime, msg.mode = clock.utime(), mode
            ends["control"].publish("CONTROL_STATUS", msg)
        if speech is not None:
            msg = speech_t()
            msg.header.utime, msg.state, msg.duration_s = clock.utime(), speech, 5.0
            ends["speech"].publish("SPEECH", msg)

    pair.run(1.0, tick)
    say(mode=control_status_t.SKILL)
    pair.run(0.5, tick)
    say(speech=speech_t.STARTED)
    pair.run(1.0, tick)
    say(speech=speech_t.FINISHED)
    pair.run(1.0, tick)
    core.stage = Stage.TRIPPED
    pair.run(1.0, tick)
    shown = [name for colour in fake.record.lights for name in LIGHTS if LIGHTS[name] == colour]
    assert shown == ["listening", "dancing", "speaking", "listening", "stopped"]
