"""The wire contract: generated code is what lcm-gen makes of the .lcm files; the table is sound."""

import math
import re
import subprocess
import sys
from pathlib import Path

import pytest

from downbeat import lcm_types
from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.codec_layout import known_types

FOLDER = Path(lcm_types.__file__).parent
LCM_FILES = sorted(FOLDER.glob("*.lcm"))
PROCESSES = {
    "sim",
    "bridge",
    "control",
    "operator",
    "source",
    "listener",
    "speech",
    "conductor",
    "checker",
}


def test_generated_python_is_what_lcm_gen_makes_of_the_lcm_files(tmp_path):
    lcm_gen = Path(sys.executable).with_name("lcm-gen")
    if not lcm_gen.exists():
        pytest.skip("lcm-gen is not installed")
    # Relative names: the path that lcm-gen is given must not enter the output.
    names = [path.name for path in LCM_FILES]
    command = [lcm_gen, "--python", "--ppath", tmp_path, *names]
    subprocess.run(command, cwd=FOLDER, check=True, capture_output=True)
    made = tmp_path / "downbeat" / "lcm_types"
    generated = {path.name: path.read_text() for path in made.glob("*.py")}
    checked_in = {path.name: path.read_text() for path in FOLDER.glob("*_t.py")}
    init = generated.pop("__init__.py")
    assert sorted(generated) == sorted(checked_in)
    for name, text in generated.items():
        assert text == checked_in[name], f"{name}: run lcm-gen again"
    exported = set(re.findall(r"import (\w+_t)\b", init))
    assert exported == set(known_types())


def test_one_struct_per_file_named_like_it():
    for path in LCM_FILES:
        structs = re.findall(r"^struct (\w+)", path.read_text(), re.MULTILINE)
        assert structs == [path.stem]
        assert "package downbeat.lcm_types;" in path.read_text()


def test_every_type_is_importable_from_the_package():
    assert sorted(known_types()) == [path.stem for path in LCM_FILES]


def test_no_two_types_share_a_fingerprint():
    fingerprints = {cls._get_packed_fingerprint() for cls in known_types().values()}
    assert len(fingerprints) == len(LCM_FILES)


@pytest.mark.parametrize("channel", CHANNELS.values(), ids=lambda channel: channel.name)
def test_channel_row_is_sound(channel):
    assert CHANNELS[channel.name] is channel
    assert re.fullmatch(r"[A-Z][A-Z0-9_]*", channel.name) and len(channel.name) < 64
    assert known_types()[channel.type.__name__] is channel.type
    assert channel.type.__slots__[0] == "header"
    assert set(channel.publishers) <= PROCESSES
    assert channel.group in ("main", "audio")
    assert channel.rate_hz >= 0.0
    if channel.rate_hz:
        # Stale only after more than one period, or every message would be late.
        assert 1.0 / channel.rate_hz < channel.stale_after_s < math.inf
    else:
        assert channel.stale_after_s == math.inf


def test_every_message_type_travels_on_some_channel():
    carried = {channel.type.__name__ for channel in CHANNELS.values()}
    assert set(known_types()) - carried == {"header_t", "imu_t"}


def test_bulk_audio_has_its_own_group():
    assert {name for name, c in CHANNELS.items() if c.group == "audio"} == {"AUDIO_CHUNK"}
    assert not CHANNELS["AUDIO_CHUNK"].logged
