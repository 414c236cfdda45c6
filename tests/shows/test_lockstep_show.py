"""A whole show in one process: heard, asked, danced; the same bytes twice; nothing breaks it."""

import base64
import json
import shutil
import struct

import numpy as np
import pytest

from downbeat.catalog.beatgrid import BeatGrid
from downbeat.catalog.setlist import SetEntry, SetList
from downbeat.catalog.tracks import Rule, Track
from downbeat.control.core import hash64
from downbeat.control.record import input_of
from downbeat.lcm_types import g1_low_state_t
from downbeat.lcm_types.channels import CHANNELS
from downbeat.perception.source import Recording
from downbeat.runtime.bus import MemqHub
from downbeat.runtime.clock import SIM_EPOCH_UTIME, SimClock
from downbeat.runtime.codec import codec_for
from downbeat.sim.lockstep import Lockstep
from downbeat.tools.errors import ToolError
from downbeat.tools.eval_mashup import write_show
from downbeat.tools.mashup import build_mashup
from downbeat.tools.recordings import INDEX_NAME, Library, build_index, write_track
from downbeat.tools.replay import verify
from downbeat.tools.report import report
from downbeat.tools.run_lockstep import run_lockstep
from downbeat.tools.show import make_conductor, make_control, make_listener, make_sim

RATE = 44_100
CONTRACT_KEYS = (
    "falls",
    "safety_trips",
    "announced",
    "unannounced",
    "beat_phase_error_ms",
    "physical_lag_ms",
    "transitions",
    "control",
    "bus",
    "chunks",
    "plant_realtime_factor",
    "replay_equal",
    "versions",
    "seed",
)
TRACKS = {
    "first": Track("first", "sway", BeatGrid(120.0), (Rule(0, 8, "kpop"),), duration_s=30.0),
    "second": Track("second", "thriller", BeatGrid(110.0), duration_s=30.0),
}


def tune(seed, bpm):
    """Return 30 s of chords and clicks, no two bars alike."""
    rng = np.random.default_rng(seed)
    beat = round(60.0 / bpm * RATE)
    out = np.zeros(30 * RATE, np.float32)
    t = np.arange(beat) / RATE
    for start in range(0, len(out) - beat, beat):
        for pitch in rng.choice(np.arange(45, 84), 4, replace=False):
            hertz = 440.0 * 2 ** ((pitch - 69) / 12)
            for harmonic in (1, 2, 3, 5):
                wave = np.sin(2 * np.pi * hertz * harmonic * t) / harmonic
                out[start : start + beat] += 0.04 * wave * np.exp(-3 * t)
    return out


@pytest.fixture(scope="module")
def show_dir(tmp_path_factory):
    """Two passages of 16 s with a rule change in the first, announced."""
    folder = tmp_path_factory.mktemp("show")
    recordings = {
        "first": Recording("first", tune(1, 120.0), RATE),
        "second": Recording("second", tune(2, 110.0), RATE),
    }
    catalog = folder / "catalog"
    catalog.mkdir()
    for track in TRACKS.values():
        write_track(catalog / f"{track.name}.toml", track)
    build_index(recordings, catalog / INDEX_NAME)
    library = Library(TRACKS, recordings, catalog)
    set_list = SetList((SetEntry("first", 0.0, 16.0), SetEntry("second", 4.0, 12.0)))
    mashup = build_mashup(set_list, TRACKS, recordings, announced=True)
    return write_show(folder, mashup, library, seed=3), folder, mashup


@pytest.fixture(scope="module")
def finished(show_dir, tmp_path_factory):
    """The show, run once: (show, run folder)."""
    show, folder, mashup = show_dir
    run_lockstep(show, folder, mashup.truth["duration_s"])
    return show, folder


def test_show_is_followed_on_the_boundaries_without_a_fall(finished):
    metrics = report(finished[1])
    assert metrics["falls"] == 0
    assert metrics["safety_trips"] == 0
    assert metrics["announced"]["followed"] == metrics["announced"]["total"] == 2
    assert metrics["announced"]["onset_error_ms"]["max"] <= 100.0
    assert metrics["unannounced"]["followed"] == 1
    assert metrics["unannounced"]["reaction_s"]["max"] <= 2.5
    assert metrics["beat_phase_error_ms"]["p95"] <= 20.0


def test_metrics_have_the_contracts_keys(finished):
    metrics = json.loads((finished[1] / "metrics.json").read_text())
    for key in CONTRACT_KEYS:
        assert key in metrics
    assert {"total", "followed", "onset_error_ms"} <= set(metrics["announced"])
    assert {"direct", "blended", "via_stand", "refused"} <= set(metrics["transitions"])


def test_run_replays_bit_for_bit(finished):
    verdict = verify(finished[1])
    assert verdict.is_equal, verdict.difference
    assert verdict.ticks > 1000
    assert verdict.logged_commands == verdict.ticks


def test_replay_names_the_first_difference(finished, tmp_path):
    """One bit of one joint in one consumed state, and the replay says where it began to matter."""
    folder = tmp_path / "run"
    shutil.copytree(finished[1], folder)
    lines = (folder / "journal").read_text().splitlines()
    record = json.loads(lines[501])
    inputs = input_of(record)
    inputs.state.joint_pos[4] = np.nextafter(inputs.state.joint_pos[4], np.float32(9))
    record["state"] = base64.b64encode(codec_for(g1_low_state_t).encode(inputs.state)).decode()
    lines[501] = json.dumps(record)
    (folder / "journal").write_text("\n".join(lines) + "\n")
    difference = verify(folder).difference
    assert difference.tick == 500
    assert difference.field == "input"
    forged = hash64(inputs.state.joint_pos, inputs.state.joint_vel)
    lines[501] = json.dumps(record | {"input": forged})
    (folder / "journal").write_text("\n".join(lines) + "\n")
    assert verify(folder).difference.field == "obs"


def test_replay_shows_both_values_of_a_changed_command(finished, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished[1], folder)
    lines = (folder / "journal").read_text().splitlines()
    lines[601] = json.dumps(json.loads(lines[601]) | {"command": 1})
    (folder / "journal").write_text("\n".join(lines) + "\n")
    difference = verify(folder).difference
    assert (difference.tick, difference.field) == (600, "command")


def test_replay_refuses_other_policies(finished, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(finished[1], folder)
    lines = (folder / "journal").read_text().splitlines()
    header = json.loads(lines[0])
    header["config"]["policies"]["stand"] = "0" * 64
    (folder / "journal").write_text("\n".join([json.dumps(header), *lines[1:]]) + "\n")
    with pytest.raises(ToolError, match="replay needs the same files"):
        verify(folder)


def test_two_runs_leave_the_same_journal_and_log(finished, tmp_path):
    show, folder = finished
    run_lockstep(show, tmp_path, 28.0)
    assert (tmp_path / "journal").read_bytes() == (folder / "journal").read_bytes()
    assert (tmp_path / "run.lcmlog").read_bytes() == (folder / "run.lcmlog").read_bytes()


def test_truth_file_is_opened_by_no_process(show_dir, tmp_path):
    """The processes run just as well where there is no truth file."""
    import shutil

    show, folder, _ = show_dir
    for name in ("show.toml", "mashup.wav", "setlist.toml"):
        shutil.copy(folder / name, tmp_path)
    shutil.copytree(folder / "catalog", tmp_path / "catalog")
    from downbeat.tools.show import load_show

    run_lockstep(load_show(tmp_path / "show.toml"), tmp_path, 4.0)
    assert not (tmp_path / "truth.json").exists()


def bad_payloads():
    """Return (name, bytes) of messages that no receiver may believe."""
    state = g1_low_state_t()
    state.wireless_remote = bytes(40)
    good = state.encode()
    nan = bytearray(good)
    nan[60:64] = struct.pack(">f", float("nan"))
    return [
        ("empty", b""),
        ("truncated", good[:-7]),
        ("extended", good + b"xx"),
        ("wrong fingerprint", b"\0" * 8 + good[8:]),
        ("not a number", bytes(nan)),
        ("noise", np.random.default_rng(0).bytes(400)),
    ]


def test_bad_messages_on_any_channel_change_nothing_but_a_counter(show_dir):
    show = show_dir[0]

    def run(spoil):
        clock = SimClock(SIM_EPOCH_UTIME)
        hub = MemqHub(seed=1)
        sent = []
        hub.tap(lambda utime, channel, payload: sent.append((utime, channel, payload)))
        buses = {n: hub.endpoint(n, clock) for n in ("sim", "listener", "conductor", "control")}
        nodes = (
            make_sim(show, buses["sim"]),
            make_listener(show, buses["listener"], SIM_EPOCH_UTIME + 500_000),
            make_conductor(show, buses["conductor"]),
            make_control(show, buses["control"]),
        )
        scheduler = Lockstep(clock, nodes)
        end = SIM_EPOCH_UTIME + 2_500_000
        while clock.utime() < end:
            scheduler.run_until(clock.utime() + 100_000)
            if spoil:
                quiet = len(sent)
                for channel in CHANNELS:
                    for _, payload in bad_payloads():
                        hub.deliver(clock.utime(), channel, payload)
                del sent[quiet:]
        rejected = {name: bus.counters.rejected for name, bus in buses.items()}
        commands = [(t, p) for t, c, p in sent if c == "G1_LOW_CMD"]
        requests = [(t, p) for t, c, p in sent if c == "SKILL_REQUEST"]
        return commands, requests, rejected

    clean, spoilt = run(False), run(True)
    assert clean[0] == spoilt[0]
    assert clean[1] == spoilt[1]
    assert sum(clean[2].values()) == 0
    assert spoilt[2]["control"] >= 100
    assert spoilt[2]["conductor"] > 0 and spoilt[2]["sim"] > 0
