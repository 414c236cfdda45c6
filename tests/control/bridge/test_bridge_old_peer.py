"""The robot's own programs use Cyclone DDS 0.10: ours must neither crash nor confuse them.

DOWNBEAT_DDS_0_10 names a Python (3.10 or older) with cyclonedds 0.10.2; without it these skip.
"""

import hashlib
import json
import os
import subprocess
from pathlib import Path

import pytest
from bridge_rig import DOMAINS, Child, free_lcm_url

import downbeat.control.bridge as bridge_package

IDL = Path(bridge_package.__file__).with_name("idl.py")
PEER = Path(__file__).with_name("peer_0_10.py")
OLD_HASHES = {
    "LowCmd_": ("eb917448d4", "18064d584d"),
    "LowState_": ("a07d4afcb2", "9c6febb0f9"),
    "IMUState_": ("7a5a119dcb", "93dcf40834"),
    "BmsState_": ("51198d722f", "36a1a1a4dd"),
    "Request_": ("ddad519e19", "52c55d5647"),
    "Response_": ("6c54d64851", "a23d2c542b"),
}
"""SHA-1 of the type information and the type map as 0.10.2 writes them with uint8."""


@pytest.fixture
def old_python():
    path = os.environ.get("DOWNBEAT_DDS_0_10", "")
    if not path or not Path(path).exists():
        pytest.skip("DOWNBEAT_DDS_0_10 names no Python with cyclonedds 0.10.2")
    return path


@pytest.mark.parametrize("name", OLD_HASHES)
def test_type_descriptions_are_byte_for_byte_those_of_the_old_library(name):
    idl = pytest.importorskip("downbeat.control.bridge.idl", reason="needs cyclonedds")
    described = getattr(idl, name).__idl__
    described.populate()
    described.fill_type_data()
    hashes = tuple(hashlib.sha1(blob).hexdigest()[:10] for blob in described._xt_bytedata)
    assert hashes == OLD_HASHES[name]


def test_bridge_takes_over_a_robot_on_the_old_library_and_both_end_well(old_python, tmp_path):
    import sys

    domain = next(DOMAINS)
    peer = Child([old_python, str(PEER), str(IDL), str(domain), "9"])
    peer.says("ready")
    settings = tmp_path / "bridge.toml"
    settings.write_text("ramp_s = 1.0\nleave_s = 0.6\nstate_stale_s = 0.4\n")
    argv = [sys.executable, "-m", "downbeat.tools.cli", "bridge", "--interface", "lo"]
    argv += ["--domain", str(domain), "--url", free_lcm_url(), "--auto"]
    bridge = Child([*argv, "--settings", str(settings)], "stderr")
    bridge.says("to pose")
    bridge.process.terminate()
    assert bridge.process.wait(timeout=10) == 0
    result = json.loads(peer.says("states", 20.0))
    assert peer.process.wait(timeout=10) == 0
    bridge.stop()
    peer.stop()
    assert result["kinds"] == ["zero", "damping", "position"]
    assert result["commands"] > 100 and result["intact"] == result["checked"] > 30
    assert result["requests"] >= 2


def test_a_robot_that_dies_leaves_the_bridge_alive_until_it_is_told_to_leave(old_python, tmp_path):
    import sys

    domain = next(DOMAINS)
    peer = Child([old_python, str(PEER), str(IDL), str(domain), "60"])
    peer.says("ready")
    argv = [sys.executable, "-m", "downbeat.tools.cli", "bridge", "--interface", "lo"]
    bridge = Child([*argv, "--domain", str(domain), "--url", free_lcm_url(), "--auto"], "stderr")
    bridge.says("zero torque")
    peer.process.send_signal(subprocess.signal.SIGKILL)
    bridge.says("The robot has not reported")
    assert bridge.stop() == 0
    peer.stop()
