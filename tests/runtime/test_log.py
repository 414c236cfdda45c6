"""The LCM event log, the bus that reads it, and the journal."""

import json

import lcm
import pytest
from sample_messages import low_state, request

from downbeat.lcm_types import audio_chunk_t, g1_low_cmd_t
from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.bus import MemqHub, open_udpm
from downbeat.runtime.clock import SIM_EPOCH_UTIME, ReplayClock, SimClock, WallClock
from downbeat.runtime.journal import JournalError, JournalWriter, read_journal
from downbeat.runtime.log import (
    LOGGED_CHANNELS,
    LogBus,
    LogError,
    LogWriter,
    RecorderNode,
    read_events,
    read_messages,
)


def lockstep_log(path):
    clock, hub = SimClock(), MemqHub()
    writer = LogWriter(path)
    hub.tap(writer.write)
    sim, control = hub.endpoint("sim", clock), hub.endpoint("control", clock)
    source = hub.endpoint("source", clock)
    for _ in range(20):
        clock.advance_to(clock.utime() + 20_000)
        sim.publish("G1_LOW_STATE", low_state(clock.utime()))
        control.publish("G1_LOW_CMD", g1_low_cmd_t())
        chunk = audio_chunk_t()
        chunk.sample_rate_hz = 16_000
        source.publish("AUDIO_CHUNK", chunk)
    writer.close()
    return writer.count


def test_lockstep_log_holds_every_logged_channel_in_order(tmp_path):
    path = tmp_path / "run.lcmlog"
    assert lockstep_log(path) == 40
    events = list(read_events(path))
    assert [event.channel for event in events] == ["G1_LOW_STATE", "G1_LOW_CMD"] * 20
    assert events[0].utime == SIM_EPOCH_UTIME + 20_000
    assert [e.utime for e in events] == sorted(e.utime for e in events)
    assert not CHANNELS["AUDIO_CHUNK"].logged and "AUDIO_CHUNK" not in LOGGED_CHANNELS
    states = list(read_messages(path, ["G1_LOW_STATE"]))
    assert [state.msg.header.seq for state in states] == list(range(20))


def test_identical_runs_leave_identical_logs(tmp_path):
    for name in ("a", "b"):
        lockstep_log(tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_log_bus_delivers_up_to_its_clock_and_checks_like_the_wire(tmp_path):
    path = tmp_path / "run.lcmlog"
    lockstep_log(path)
    log = lcm.EventLog(str(tmp_path / "bad.lcmlog"), "w", overwrite=True)
    for event in read_events(path):
        log.write_event(event.utime, event.channel, event.payload)
    log.write_event(SIM_EPOCH_UTIME + 500_000, "G1_LOW_STATE", b"junk")
    log.close()
    clock = ReplayClock(SIM_EPOCH_UTIME)
    bus = LogBus(tmp_path / "bad.lcmlog", clock, "control")
    bus.subscribe("G1_LOW_STATE")
    assert bus.pump() == 0
    clock.follow(bus.next_utime)
    assert bus.pump() == 2
    assert bus.latest("G1_LOW_STATE").recv_utime == SIM_EPOCH_UTIME + 20_000
    bus.publish("G1_LOW_CMD", g1_low_cmd_t())
    clock.follow(SIM_EPOCH_UTIME + 10**9)
    bus.pump()
    assert bus.next_utime is None
    assert len(bus.take("G1_LOW_STATE")) == 20
    assert bus.counters.rejected == 1 and bus.counters.lost == 0
    bus.close()


def test_log_that_was_cut_off_ends_early(tmp_path):
    path = tmp_path / "run.lcmlog"
    lockstep_log(path)
    path.write_bytes(path.read_bytes()[:-100])
    assert len(list(read_events(path))) == 39


def test_missing_log_is_one_sentence(tmp_path):
    with pytest.raises(LogError, match="no log"):
        next(read_events(tmp_path / "none.lcmlog"))
    with pytest.raises(LogError, match="cannot be written"):
        LogWriter(tmp_path / "none" / "run.lcmlog")


def test_recorder_writes_payloads_as_received(tmp_path, free_url):
    clock = WallClock()
    recorder = RecorderNode(free_url, clock, tmp_path / "run.lcmlog")
    sim = open_udpm(free_url, clock, "sim")
    conductor = open_udpm(free_url, clock, "conductor")
    sent = []
    for number in range(1, 6):
        sim.publish("G1_LOW_STATE", low_state())
        conductor.publish("SKILL_REQUEST", request(number))
        sent += ["G1_LOW_STATE", "SKILL_REQUEST"]
    raw = lcm.LCM(f"{free_url}&recv_buf_size=100000")
    raw.publish("ESTOP", b"not a message")
    for _ in range(200):
        recorder.step(clock.utime())
        if recorder.writer.count == 11:
            break
        clock.sleep_until(clock.utime() + 5_000)
    recorder.close()
    events = list(read_events(tmp_path / "run.lcmlog"))
    assert sorted(e.channel for e in events) == sorted([*sent, "ESTOP"])
    assert [e.payload for e in events if e.channel == "ESTOP"] == [b"not a message"]
    assert len(list(read_messages(tmp_path / "run.lcmlog"))) == 10


def test_identical_journals_have_identical_bytes(tmp_path):
    for name, order in (("a", ("tick", "x")), ("b", ("x", "tick"))):
        writer = JournalWriter(tmp_path / name, {"seed": 3, "skills": ["stand"]})
        values = {"tick": 7, "x": 0.1 + 0.2}
        writer.write({key: values[key] for key in order})
        writer.close()
        writer.write({"after": "close"})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_journal_reads_back_exactly_and_names_what_results_depend_on(tmp_path):
    path = tmp_path / "journal"
    writer = JournalWriter(path, {"seed": 3})
    records = [{"tick": i, "phase_s": i / 3, "hash": -(2**63) + i} for i in range(50)]
    for record in records:
        writer.write(record)
    writer.close()
    journal = read_journal(path)
    assert journal.records == records and journal.is_complete
    assert journal.header["config"] == {"seed": 3}
    assert journal.header["versions"]["lcm"] and journal.header["versions"]["numpy"]
    assert journal.header["cpu"]["machine"]


def test_journal_that_was_cut_off_is_read_to_the_last_whole_record(tmp_path):
    path = tmp_path / "journal"
    writer = JournalWriter(path, {})
    for tick in range(3):
        writer.write({"tick": tick})
    writer.close()
    path.write_bytes(path.read_bytes()[:-4])
    journal = read_journal(path)
    assert [r["tick"] for r in journal.records] == [0, 1] and not journal.is_complete


def test_what_is_not_a_journal_is_refused_with_its_line(tmp_path):
    path = tmp_path / "journal"
    with pytest.raises(JournalError, match="no journal"):
        read_journal(path)
    path.write_text(json.dumps({"tick": 1}) + "\n")
    with pytest.raises(JournalError, match="header"):
        read_journal(path)
    path.write_text('{"journal": 1}\nnonsense\n')
    with pytest.raises(JournalError, match="journal:2"):
        read_journal(path)
    with pytest.raises(JournalError, match="plain JSON"):
        JournalWriter(path, {"clock": SimClock()})
