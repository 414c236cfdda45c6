"""A robot and a bridge as processes of their own: DDS on loopback between them, LCM behind."""

import itertools
import json
import os
import select
import socket
import subprocess
import sys
import time

DOMAINS = itertools.count(20 + os.getpid() % 100)
"""A DDS domain per rig: tests never meet each other."""
QUICK = (
    "ramp_s = 1.0\nremote_lost_s = 1.0\nleave_s = 0.6\ncontrol_timeout_s = 3.0\n"
    "state_stale_s = 0.2\n"
)
"""Settings for scenarios: the same steps in less time, and a stale limit for a shared machine."""


def free_lcm_url():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return f"udpm://239.255.76.67:{min(probe.getsockname()[1], 65533)}?ttl=0"


class Child:
    """One process whose lines are read as they come."""

    def __init__(self, argv, stream="stdout"):
        self.process = subprocess.Popen(
            argv,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE if stream == "stdout" else None,
            stderr=subprocess.PIPE if stream == "stderr" else None,
        )
        self._pipe = getattr(self.process, stream)
        self._rest = b""
        self.lines = []

    def read(self, timeout_s=0.0):
        """Collect what was said."""
        end = time.monotonic() + timeout_s
        while select.select([self._pipe], [], [], max(0.0, end - time.monotonic()))[0]:
            chunk = os.read(self._pipe.fileno(), 65536)
            if not chunk:
                break
            *whole, self._rest = (self._rest + chunk).split(b"\n")
            self.lines += [line.decode() for line in whole]
            timeout_s = 0.0
            end = time.monotonic()
        return self.lines

    def says(self, needle, timeout_s=15.0):
        """Wait for a line that holds `needle`; fails with everything that was said."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            for line in self.read(0.1):
                if needle in line:
                    return line
            if self.process.poll() is not None:
                self.read(0.2)
                break
        assert any(needle in line for line in self.lines), (needle, self.lines)
        return needle

    def say(self, line):
        self.process.stdin.write(line.encode() + b"\n")
        self.process.stdin.flush()

    def stop(self):
        if self.process.poll() is None:
            self.process.terminate()
        code = self.process.wait(timeout=20)
        self.read(0.2)
        for pipe in (self.process.stdin, self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()
        return code


class Rig:
    """The robot's side, the bridge, and what a test does to them."""

    def __init__(self, tmp_path, settings=QUICK, motion="", auto=True, operator=False, **options):
        self.domain = next(DOMAINS)
        self.url = free_lcm_url()
        self._settings = tmp_path / "bridge.toml"
        self._settings.write_text(settings)
        robot = [sys.executable, "-m", "downbeat.sim.fake_g1", "--domain", str(self.domain)]
        robot += ["--motion", motion] + (["--operator"] if operator else [])
        for name, value in options.items():
            robot += [f"--{name.replace('_', '-')}", str(value)]
        self.robot = Child(robot)
        self.robot.says("ready")
        self._auto = auto
        self.bridge = None
        self.others = []

    def start_bridge(self, *extra):
        argv = [sys.executable, "-m", "downbeat.tools.cli", "bridge", "--interface", "lo"]
        argv += ["--domain", str(self.domain), "--url", self.url]
        argv += ["--settings", str(self._settings), *(["--auto"] if self._auto else []), *extra]
        self.bridge = Child(argv, "stderr")
        return self.bridge

    def start(self, *argv):
        """Start another of our commands on the same bus."""
        child = Child([sys.executable, "-m", "downbeat.tools.cli", *argv, "--url", self.url])
        self.others.append(child)
        return child

    def do(self, line):
        self.robot.say(line)

    def ask(self, line="report"):
        count = len(self.robot.read())
        self.robot.say(line)
        end = time.monotonic() + 10.0
        while len(self.robot.read(0.1)) == count:
            assert time.monotonic() < end and self.robot.process.poll() is None, "robot is gone"
        return json.loads(self.robot.lines[-1])

    def wait(self, condition, timeout_s=15.0):
        """Ask for reports until one fulfils the condition."""
        end = time.monotonic() + timeout_s
        while True:
            report = self.ask()
            if condition(report):
                return report
            said = self.bridge.read() if self.bridge else []
            assert time.monotonic() < end, (report, said)
            time.sleep(0.02)

    def wait_for(self, kind, timeout_s=15.0):
        return self.wait(lambda report: report["kind"] == kind, timeout_s)

    def close(self):
        codes = [child.stop() for child in [*self.others, self.bridge, self.robot] if child]
        assert all(code == 0 for code in codes), (codes, self.bridge and self.bridge.lines)
