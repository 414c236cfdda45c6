"""lcm-spy knows our types; seen under a virtual display with traffic on a port of its own."""

import os
import shutil
import signal
import subprocess
import time
import zipfile
from pathlib import Path

import pytest

from downbeat.lcm_types import control_status_t, g1_low_state_t
from downbeat.runtime.bus import open_udpm
from downbeat.runtime.clock import WallClock
from downbeat.runtime.codec_layout import known_types
from downbeat.tools.spy import SpyError, build_types_jar, lcm_files, start_spy, types_jar_path


def need(*programs):
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")


@pytest.fixture(scope="module")
def jar_cache(tmp_path_factory):
    need("javac")
    return tmp_path_factory.mktemp("jars")


@pytest.fixture
def url(free_url):
    return free_url


@pytest.fixture
def display(tmp_path):
    """A virtual display; Xvfb chooses its number and tells it."""
    need("Xvfb", "java")
    reading, writing = os.pipe()
    with (tmp_path / "xvfb.log").open("w") as log:
        server = subprocess.Popen(
            ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1400x900x24", "-nolisten", "tcp"],
            pass_fds=[writing],
            stderr=log,
        )
    os.close(writing)
    with os.fdopen(reading) as numbers:
        number = numbers.readline().strip()
    if not number:
        server.wait()
        pytest.skip("Xvfb does not start here")
    yield f":{number}"
    server.terminate()
    server.wait()


def test_jar_holds_every_type_and_is_built_once(jar_cache):
    jar = build_types_jar(jar_cache)
    with zipfile.ZipFile(jar) as archive:
        names = {Path(name).stem for name in archive.namelist()}
    compat = {path.stem for path in lcm_files() if path.parent.name == "compat"}
    assert len(compat) == 6
    assert names == set(known_types()) | compat
    before = jar.stat().st_mtime_ns
    assert build_types_jar(jar_cache) == jar
    assert jar.stat().st_mtime_ns == before
    assert [path.name for path in jar_cache.iterdir()] == [jar.name]


def test_other_types_make_another_jar(tmp_path, monkeypatch):
    before = types_jar_path(tmp_path)
    changed = tmp_path / "new_t.lcm"
    changed.write_text("package downbeat.lcm_types; struct new_t { int8_t x; }")
    monkeypatch.setattr("downbeat.tools.spy.lcm_files", lambda: [changed])
    assert types_jar_path(tmp_path) != before


def test_missing_java_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SpyError, match="javac.*apt-get install default-jdk"):
        build_types_jar(tmp_path)
    with pytest.raises(SpyError, match="java.*apt-get install default-jdk"):
        start_spy("", tmp_path, {"DISPLAY": ":0"})


def test_missing_display_says_so(tmp_path):
    need("java")
    with pytest.raises(SpyError, match="DISPLAY"):
        start_spy("", tmp_path, {"PATH": os.environ["PATH"]})


def test_lcm_spy_finds_all_our_types(jar_cache, display, url, tmp_path):
    messages = tmp_path / "spy.log"
    environment = {**os.environ, "DISPLAY": display}
    with messages.open("w") as output:
        spy = start_spy(url, jar_cache, environment, output)
    clock = WallClock()
    sim, control = (open_udpm(url, clock, name) for name in ("sim", "control"))
    state = g1_low_state_t()
    expected = f"Found {len(lcm_files())} LCM types"
    try:
        deadline = time.monotonic() + 60
        while expected not in messages.read_text():
            assert spy.poll() is None and time.monotonic() < deadline, messages.read_text()
            state.header.utime = clock.utime()
            sim.publish("G1_LOW_STATE", state)
            control.publish("CONTROL_STATUS", control_status_t())
            time.sleep(0.02)
        assert spy.poll() is None
    finally:
        spy.send_signal(signal.SIGTERM)
        spy.wait(timeout=30)
