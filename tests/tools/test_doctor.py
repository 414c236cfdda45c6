"""The doctor's checks: each says ok on a good machine and names the remedy on a bad one."""

import subprocess

import pytest

from downbeat.runtime.bus import parse_udpm_url
from downbeat.tools import doctor, doctor_machine, doctor_network
from downbeat.tools.doctor_check import fail, ok, warn

DEFAULT = parse_udpm_url("")
ROUTES = (
    "Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\tWindow\tIRTT\n"
    "eth0\t00000000\t010200C0\t0003\t0\t0\t0\t00000000\t0\t0\t0\n"
    "eth0\t000200C0\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0\n"
)
LO_ROUTE = "lo\t000000E0\t00000000\t0001\t0\t0\t0\t000000F0\t0\t0\t0\n"


def written(path, text):
    path.write_text(text)
    return path


def test_every_check_runs_and_every_problem_has_a_fix(monkeypatch):
    monkeypatch.setattr(doctor_network, "LISTEN_S", 0.05)
    monkeypatch.setattr(doctor_machine, "STEAL_WATCH_S", 0.05)
    # The bursts and the GL trial have tests of their own.
    monkeypatch.setattr(doctor_network, "check_two_processes", lambda: ok("two processes", ""))
    monkeypatch.setattr(doctor_machine, "check_rendering", lambda: ok("rendering", ""))
    results = doctor.run_doctor()
    names = [result.name for result in results]
    assert names == [name for name, _ in doctor.checks_for("")]
    for result in results:
        assert result.detail or result.status == "ok"
        assert bool(result.fix) == (result.status != "ok"), result
        assert "broke" not in result.detail


def test_wrong_url_is_a_failed_check():
    (result,) = doctor.run_doctor("tcpq://127.0.0.1")
    assert result.status == "fail" and not doctor.is_healthy([result])


def test_check_that_breaks_is_a_failed_check(monkeypatch):
    def broken():
        raise OSError("no such thing")

    monkeypatch.setattr(doctor, "checks_for", lambda *asked: [("broken", broken)])
    (result,) = doctor.run_doctor()
    assert result.status == "fail" and "no such thing" in result.detail


def test_warnings_are_healthy_failures_are_not():
    assert doctor.is_healthy([ok("a", "x"), warn("b", "y", "z")])
    assert not doctor.is_healthy([ok("a", "x"), fail("b", "y", "z")])


@pytest.mark.parametrize(("version", "status"), [("1.5.3", "ok"), ("1.5.2", "fail"), ("2.0", "ok")])
def test_lcm_that_crashes_on_bad_fragments_fails(monkeypatch, version, status):
    monkeypatch.setattr(doctor_network.metadata, "version", lambda name: version)
    assert doctor_network.check_lcm_version().status == status


def test_url_that_leaves_the_machine_warns():
    assert doctor_network.check_url(DEFAULT).status == "ok"
    assert doctor_network.check_url(parse_udpm_url("udpm://239.1.2.3:7?ttl=1")).status == "warn"


def test_loopback_state_is_read_from_its_flags(tmp_path):
    assert doctor_network.check_loopback(written(tmp_path / "up", "0x9\n")).status == "ok"
    down = doctor_network.check_loopback(written(tmp_path / "down", "0x8\n"))
    assert down.status == "fail" and down.fix == "ip link set lo up"
    assert doctor_network.check_loopback(tmp_path / "none").status == "warn"


def test_longest_matching_route_wins():
    assert doctor_network.route_interface("239.255.76.67", ROUTES) == "eth0"
    assert doctor_network.route_interface("239.255.76.67", ROUTES + LO_ROUTE) == "lo"
    assert doctor_network.route_interface("192.0.2.9", ROUTES + LO_ROUTE) == "eth0"
    assert doctor_network.route_interface("239.255.76.67", ROUTES.splitlines()[0]) == ""


def test_route_over_a_cable_warns_and_says_what_to_type(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor_network, "check_multicast", lambda url: None)
    result = doctor_network.check_route(DEFAULT, written(tmp_path / "route", ROUTES))
    assert result.status == "warn" and result.fix == "ip route add 239.255.76.66/31 dev lo"
    both = written(tmp_path / "both", ROUTES + LO_ROUTE)
    assert doctor_network.check_route(DEFAULT, both).status == "ok"


def test_small_receive_buffer_warns(tmp_path):
    small = doctor_network.check_receive_buffer(written(tmp_path / "small", "212992\n"))
    assert small.status == "warn" and small.fix == "sysctl -w net.core.rmem_max=4194304"
    large = doctor_network.check_receive_buffer(written(tmp_path / "large", "4194304\n"))
    assert large.status == "ok"


def test_two_processes_hear_each_other():
    try:
        doctor_network.check_multicast(DEFAULT)
    except doctor_network.MulticastError as error:
        pytest.skip(str(error))
    result = doctor_network.self_test()
    assert result.sent == 1100
    # Whether all arrive is the machine's business; that they arrive and are timed is ours.
    assert 0 < result.received <= result.sent
    assert len(result.latencies_us) == result.received and min(result.latencies_us) > 0.0
    assert result.buffer_errors >= 0


@pytest.mark.parametrize(("received", "status"), [(0, "fail"), (9, "warn"), (10, "ok")])
def test_loss_between_two_processes_is_judged(monkeypatch, received, status):
    made = doctor_network.SelfTest(10, received, [50.0] * received, 0)
    monkeypatch.setattr(doctor_network, "self_test", lambda: made)
    assert doctor_network.check_two_processes().status == status


def test_other_publishers_are_named(monkeypatch):
    monkeypatch.setattr(doctor_network, "foreign_traffic", lambda url, s: {"G1_LOW_CMD": 50})
    result = doctor_network.check_others(DEFAULT)
    assert result.status == "warn" and "G1_LOW_CMD (50)" in result.detail


def test_buffer_errors_are_read_by_name(tmp_path):
    text = "Udp: InDatagrams NoPorts RcvbufErrors\nUdp: 5 6 7\n"
    assert doctor_network.receive_buffer_errors(written(tmp_path / "snmp", text)) == 7


def test_scheduling_that_is_refused_warns(monkeypatch):
    refused = subprocess.CompletedProcess([], 1)
    monkeypatch.setattr(doctor_machine.subprocess, "run", lambda *a, **k: refused)
    result = doctor_machine.check_scheduling()
    assert result.status == "warn" and "ulimit -r" in result.fix


def test_throttling_that_is_off_warns(tmp_path):
    assert doctor_machine.check_rt_throttling(written(tmp_path / "on", "950000")).status == "ok"
    assert doctor_machine.check_rt_throttling(written(tmp_path / "off", "-1")).status == "warn"


def test_governor_that_saves_power_warns(tmp_path):
    slow = doctor_machine.check_governor(written(tmp_path / "slow", "powersave\n"))
    assert slow.status == "warn"
    fast = doctor_machine.check_governor(written(tmp_path / "fast", "performance\n"))
    assert fast.status == "ok"
    assert doctor_machine.check_governor(tmp_path / "none").status == "ok"


def test_steal_is_the_eighth_number(tmp_path):
    assert doctor_machine.cpu_times("cpu  1 2 3 4 5 6 7 8 9 10\ncpu0 1")[7] == 8
    assert doctor_machine.cpu_times("cpu  1 2 3 4")[7] == 0


def test_control_process_is_light():
    assert doctor_machine.check_control_imports().status == "ok"


def test_missing_java_warns_and_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    result = doctor_machine.check_java()
    assert result.status == "warn" and "default-jdk" in result.fix
