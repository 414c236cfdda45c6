"""The doctor's checks for a robot: DDS, who commands it, sound, versions, types."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path
from typing import Any

from downbeat import lcm_types
from downbeat.control.bridge.dds_config import LOOPBACK, DdsError, port_clash
from downbeat.control.bridge.lowstate import StateDecoder
from downbeat.runtime.udpm import UdpmUrl
from downbeat.tools.doctor_check import CheckResult, fail, ok, warn

LISTEN_S = 1.5
OLDEST_DDS = (11, 0)
G1_FIX = "pip install 'downbeat[g1]'"
SAME_MINOR = ("mujoco", "mujoco-mjx")
"""4.0.0 with mjx 3.17.0 is silently wrong when actuators saturate: 17 rad/s after one step."""


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


def check_versions() -> CheckResult:
    """What is installed must be what the project asks for."""
    problems = []
    listed = [f"python {sys.version.split()[0]}"]
    for requirement in metadata.requires("downbeat") or []:
        if "extra ==" in requirement:
            continue
        name = re.split(r"[<>=!~ ;\[]", requirement, maxsplit=1)[0]
        version = _version(name)
        exact = re.search(r"==\s*([\w.]+)", requirement)
        if not version:
            problems.append(f"{name} is missing")
        elif exact and exact[1] != version:
            problems.append(f"{name} is {version}, wanted {exact[1]}")
        elif name in ("numpy", "onnxruntime", "mujoco"):
            listed.append(f"{name} {version}")
    minors = {_version(name).rsplit(".", 1)[0] for name in SAME_MINOR if _version(name)}
    if len(minors) > 1:
        both = " and ".join(f"{name} {_version(name)}" for name in SAME_MINOR)
        problems.append(f"{both} do not belong together")
    if problems:
        return fail("versions", "; ".join(problems), "make setup")
    return ok("versions", ", ".join(listed))


def check_types() -> CheckResult:
    """The generated types must be what lcm-gen makes of the .lcm files: same fingerprints."""
    folder = Path(lcm_types.__file__).parent
    generator = Path(sys.executable).with_name("lcm-gen")
    names = sorted(path.name for path in folder.glob("*_t.lcm"))
    if not generator.exists():
        return warn("types", "lcm-gen is not installed", "Install the lcm of constraints.txt.")
    with tempfile.TemporaryDirectory() as made:
        command = [str(generator), "--python", "--ppath", made, *names]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        fresh = Path(made) / "downbeat" / "lcm_types"
        stale = [
            name
            for name in (f"{Path(lcm).stem}.py" for lcm in names)
            if done.returncode or (fresh / name).read_text() != (folder / name).read_text()
        ]
    if stale:
        return fail(
            "types",
            f"{', '.join(stale)} not what lcm-gen makes of the .lcm files",
            "cd lcm_types && lcm-gen --python --ppath ../.. *_t.lcm, or install Downbeat again",
        )
    return ok(
        "types",
        f"{len(names)} types, as lcm-gen makes them; the Java jar is made of the same files",
    )


def check_dds_version() -> CheckResult:
    """The bridge needs cyclonedds; nothing else does."""
    version = _version("cyclonedds")
    if not version:
        return warn("dds version", "cyclonedds is not installed: no bridge to a robot", G1_FIX)
    numbers = tuple(int(part) for part in re.findall(r"\d+", version)[:2])
    if numbers < OLDEST_DDS:
        return fail("dds version", f"{version} knows no IDL type `byte`", G1_FIX)
    return ok("dds version", version)


def check_dds_ports(domain: int, url: UdpmUrl) -> CheckResult:
    """DDS must not take LCM's port."""
    clash = port_clash(domain, url.port)
    if not clash:
        return ok("dds ports", f"domain {domain} stays clear of UDP {url.port}")
    return warn("dds ports", clash, "Use --domain 0, or another port in --url.")


def check_robot(interface: str, domain: int) -> CheckResult:
    """With an interface: is there a robot, is it ours, does somebody command it?"""
    if not interface:
        return ok("robot", "not looked for; --interface says where it is")
    if not _version("cyclonedds"):
        return fail("robot", "cyclonedds is not installed", G1_FIX)
    from downbeat.control.bridge import idl
    from downbeat.control.bridge.dds import Link

    try:
        link = Link(interface, domain)
    except DdsError as error:
        return fail("robot", str(error), "ip link")
    states = link.reader("rt/lowstate", idl.LowState_)
    commands = link.reader("rt/lowcmd", idl.LowCmd_)
    decoder = StateDecoder(lenient=interface == LOOPBACK)
    heard = commanded = 0
    first = last = 0.0
    end = time.monotonic() + LISTEN_S
    while time.monotonic() < end:
        link.wait(0.002)
        time.sleep(0.002)
        samples = states.take()
        for payload in samples:
            decoder.take(payload)
        if samples:
            last = time.monotonic()
            first = first or last
        heard += len(samples)
        commanded += len(commands.take())
    writers = link.publishers_of("rt/lowstate")
    link.close()
    rate = heard / max(last - first, 0.1)
    return judge_robot(interface, decoder, rate if heard else 0.0, commanded, writers)


def judge_robot(
    interface: str, decoder: Any, rate_hz: float, commanded: int, writers: int
) -> CheckResult:
    """Say what was heard.

    Args:
        interface: Where.
        decoder: What the states were.
        rate_hz: Of the states.
        commanded: LowCmd of somebody else.
        writers: How many participants announce rt/lowstate.
    """
    if not rate_hz:
        if writers:
            detail = f"somebody announces rt/lowstate on {interface}, with a type that is not ours"
            return fail("robot", detail, "See docs/robot.md, Simulators.")
        detail = f"nobody publishes rt/lowstate on {interface}"
        return fail("robot", detail, f"ip addr show {interface}; ping 192.168.123.161")
    counters = decoder.counters
    if not counters.accepted:
        return fail("robot", f"{rate_hz:.0f} Hz, none good: {counters.last_reason}", "See its log.")
    if commanded:
        return warn(
            "robot",
            f"somebody commands it ({commanded} LowCmd in {LISTEN_S} s)",
            "Stop that program; release the robot's own motion service.",
        )
    detail = f"{rate_hz:.0f} Hz, mode_machine {decoder.mode_machine}, {counters.lost} lost"
    bad = sum(counters.rejected.values())
    if bad:
        return warn("robot", f"{detail}, {bad} bad: {counters.last_reason}", "Check the cable.")
    return ok("robot", detail)


def check_audio(cards_file: Path = Path("/proc/asound/cards")) -> CheckResult:
    """A microphone and a loudspeaker; a show from a file needs neither."""
    try:
        import sounddevice

        devices = sounddevice.query_devices()
        names = [device["name"] for device in devices if device["max_input_channels"] > 0]
        inputs = len(names)
        outputs = sum(device["max_output_channels"] > 0 for device in devices)
    except (ImportError, OSError) as error:
        return warn(
            "audio devices",
            f"PortAudio is not usable ({error}): sound from files and from the robot only",
            "apt-get install libportaudio2 && pip install 'downbeat[listen]'",
        )
    if inputs and outputs:
        listed = ", ".join(f'"mic:{name}"' for name in names)
        return ok("audio devices", f"{inputs} inputs ({listed}), {outputs} outputs")
    cards = cards_file.exists() and "no soundcards" not in cards_file.read_text()
    return warn(
        "audio devices",
        f"{inputs} inputs, {outputs} outputs{'' if cards else ', no sound card'}",
        "Plug one in, or use the robot's (docs/robot.md, Sound).",
    )
