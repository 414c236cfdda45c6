"""What heartbeats say about a process's cost."""

from downbeat.lcm_types import heartbeat_t
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SimClock
from downbeat.runtime.node import Heartbeat
from downbeat.runtime.usage import Usage, own_usage, usage_in


def test_usage_survives_the_way_through_a_text():
    usage = Usage(12.345, 84_123)
    assert usage_in(f"3 deadlines missed {usage.text()}") == usage
    assert usage_in("3 deadlines missed") is None


def test_usage_grows_with_what_the_process_holds():
    before = own_usage()
    block = bytearray(b"x" * 64_000_000)  # over what malloc keeps for reuse
    after = own_usage()
    assert after.memory_kb - before.memory_kb > len(block) / 1024 * 0.8
    assert after.cpu_s >= before.cpu_s > 0.0


def test_every_heartbeat_says_what_its_process_used():
    clock = SimClock()
    hub = MemqHub()
    listener = hub.endpoint("operator", clock)
    listener.subscribe("HEARTBEAT")
    heartbeat = Heartbeat(hub.endpoint("control", clock), "control", 20_000)
    heartbeat.publish(clock.utime(), heartbeat_t.STARTING)
    heartbeat.beat(clock.utime() + 1_000_000, missed=2)
    listener.pump()
    details = [received.msg.detail for received in listener.take("HEARTBEAT")]
    assert all(usage_in(detail) for detail in details) and len(details) == 2
    assert details[1].startswith("2 deadlines missed [cpu")
