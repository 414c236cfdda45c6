"""The compatibility types: what lcm-gen makes of them, and the fingerprints of the field."""

import subprocess
import sys
from pathlib import Path

import pytest

from downbeat.lcm_types import compat
from downbeat.runtime.codec_layout import known_types

FOLDER = Path(compat.__file__).parent
FILES = sorted(path.name for path in FOLDER.glob("*.lcm"))


def test_generated_python_is_what_lcm_gen_makes_of_the_files(tmp_path):
    lcm_gen = Path(sys.executable).with_name("lcm-gen")
    if not lcm_gen.exists():
        pytest.skip("lcm-gen is not installed")
    command = [lcm_gen, "--python", "--ppath", tmp_path, *FILES]
    subprocess.run(command, cwd=FOLDER, check=True, capture_output=True)
    made = tmp_path / "downbeat" / "lcm_types" / "compat"
    assert {p.name: p.read_text() for p in made.glob("*.py")} == {
        p.name: p.read_text() for p in FOLDER.glob("*.py")
    }


def test_body_control_data_has_the_fingerprint_that_g1_controllers_send():
    # From the C++ header of a controller in the field; names of structs do not enter it.
    assert compat.body_control_data_lcmt._get_packed_fingerprint().hex() == "f4f03934711bf8b5"


def test_compatibility_types_are_none_of_ours():
    assert not {name for name in vars(compat) if name.endswith("_lcmt")} & set(known_types())
