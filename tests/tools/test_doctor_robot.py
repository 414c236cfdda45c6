"""The doctor's checks for a robot, and the units that start us on one."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from downbeat.control.bridge.lowstate import StateDecoder
from downbeat.runtime.bus import parse_udpm_url
from downbeat.tools import doctor_robot

ROOT = Path(__file__).resolve().parents[2]
UNITS = sorted((ROOT / "docs" / "systemd").iterdir())


def test_installed_versions_and_types_are_in_order_here():
    assert doctor_robot.check_versions().status == "ok"
    assert doctor_robot.check_types().status in ("ok", "warn")


def test_a_missing_or_wrong_package_is_named(monkeypatch):
    versions = {"lcm": "", "mujoco": "3.16.0"}
    monkeypatch.setattr(doctor_robot, "_version", lambda name: versions.get(name, "9.9"))
    result = doctor_robot.check_versions()
    assert result.status == "fail"
    assert "lcm is missing" in result.detail and "mujoco is 3.16.0" in result.detail
    assert "do not belong together" in result.detail


@pytest.mark.parametrize(
    ("version", "status"), [("", "warn"), ("0.10.2", "fail"), ("11.0.1", "ok")]
)
def test_dds_version_is_judged(monkeypatch, version, status):
    monkeypatch.setattr(doctor_robot, "_version", lambda name: version)
    result = doctor_robot.check_dds_version()
    assert result.status == status and bool(result.fix) == (status != "ok")


def test_a_domain_that_takes_lcms_port_warns():
    url = parse_udpm_url("")
    assert doctor_robot.check_dds_ports(0, url).status == "ok"
    clash = doctor_robot.check_dds_ports(1, url)
    assert clash.status == "warn" and "participant 4 of DDS domain 1" in clash.detail


def decoder(accepted=0, lost=0, rejected=None):
    made = StateDecoder()
    made.counters.accepted, made.counters.lost = accepted, lost
    made.counters.rejected = rejected or {}
    made.counters.last_reason = "wrong CRC" if rejected else ""
    made.mode_machine = 5
    return made


@pytest.mark.parametrize(
    ("heard", "status", "said"),
    [
        ((decoder(), 0.0, 0, 0), "fail", "nobody publishes rt/lowstate on eth0"),
        ((decoder(), 0.0, 0, 1), "fail", "with a type that is not ours"),
        ((decoder(rejected={"wrong CRC": 9}), 500.0, 0, 1), "fail", "none good: wrong CRC"),
        ((decoder(700), 500.0, 30, 1), "warn", "somebody commands it (30 LowCmd"),
        ((decoder(700, rejected={"wrong CRC": 9}), 500.0, 0, 1), "warn", "9 bad: wrong CRC"),
        ((decoder(700), 500.0, 0, 1), "ok", "500 Hz, mode_machine 5, 0 lost"),
    ],
)
def test_what_is_heard_of_a_robot_is_judged(heard, status, said):
    result = doctor_robot.judge_robot("eth0", *heard)
    assert result.status == status and said in result.detail
    assert bool(result.fix) == (status != "ok")


def test_an_interface_that_does_not_exist_is_a_failed_check():
    pytest.importorskip("cyclonedds", reason="cyclonedds (extra g1) is not installed")
    result = doctor_robot.check_robot("nonesuch", 0)
    assert result.status == "fail" and "this machine has" in result.detail


def test_doctor_finds_a_robot_on_loopback_and_prints_a_list_of_checks():
    pytest.importorskip("cyclonedds", reason="cyclonedds (extra g1) is not installed")
    robot = subprocess.Popen(
        [sys.executable, "-m", "downbeat.sim.fake_g1", "--domain", "131"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    robot.stdout.readline()
    result = doctor_robot.check_robot("lo", 131)
    robot.communicate(b"quit\n", timeout=20)
    assert robot.returncode == 0
    assert result.status == "ok" and "mode_machine 5" in result.detail
    assert json.dumps(result.detail)


def test_missing_portaudio_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    result = doctor_robot.check_audio()
    assert result.status == "warn" and "libportaudio2" in result.fix


def test_units_are_valid_and_stop_politely(tmp_path):
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed")
    program = tmp_path / "program"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    paths = []
    for unit in UNITS:
        text = unit.read_text()
        # The programs and the user of a robot are not on this machine.
        text = re.sub(r"^(ExecStart=)\S+", rf"\g<1>{program}", text, flags=re.MULTILINE)
        text = text.replace("User=downbeat", "User=root")
        paths.append(tmp_path / unit.name)
        paths[-1].write_text(text)
    done = subprocess.run([analyze, "verify", *paths], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and not done.stderr, done.stderr


def test_units_run_commands_that_exist():
    for unit in UNITS:
        for command in re.findall(r"/bin/downbeat (.+)", unit.read_text()):
            name, *options = command.split()
            helped = subprocess.run(
                [sys.executable, "-m", "downbeat.tools.cli", name, "--help"],
                capture_output=True,
                text=True,
                check=True,
            )
            for option in options:
                assert not option.startswith("--") or option in helped.stdout, (unit.name, option)


def test_a_stop_leaves_the_bridge_time_to_brake():
    unit = (ROOT / "docs" / "systemd" / "downbeat-bridge.service").read_text()
    assert int(re.search(r"TimeoutStopSec=(\d+)", unit)[1]) > 30
    assert "Restart=no" in unit and "KillSignal=SIGTERM" in unit
