"""The operator's commands: ask, stop, arm, report, spy, doctor, bench, export."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Ask:
    """Ask a running control process for a skill (OPERATOR_SKILL_REQUEST)."""

    skill: tyro.conf.Positional[str]
    """Skill name."""
    seconds: float = 0.0
    """Then stand; 0: for ever."""
    vx: float = 0.0
    """Forward speed [m/s], walk only."""
    yaw_rate: float = 0.0
    """Turn rate [rad/s], walk only."""
    url: str = ""
    """LCM URL."""

    def run(self) -> int:
        """Ask and print the answer; 0 if it runs."""
        from downbeat.tools.operator import ask

        return ask(self.skill, self.seconds, (self.vx, 0.0, self.yaw_rate), self.url)


@dataclass(frozen=True)
class Stop:
    """Emergency stop: publish ESTOP on the bus."""

    level: Literal["damp", "zero_torque", "clear"] = "damp"
    """damp: joints damped; zero_torque: limp; clear: forget the trip, for `downbeat arm`."""
    reason: str = "operator"
    """For the log."""
    url: str = ""
    """LCM URL."""

    def run(self) -> int:
        """Publish it."""
        from downbeat.tools.operator import stop

        return stop(self.level, self.reason, self.url)


@dataclass(frozen=True)
class Arm:
    """Arm control in simulation again, after a stop that was cleared; the robot then stands."""

    url: str = ""
    """LCM URL."""

    def run(self) -> int:
        """Arm, and say whether it is armed now or why not; 0 if it is."""
        from downbeat.tools.arming import arm

        return arm(self.url)


@dataclass(frozen=True)
class Replay:
    """Play a run's log on the bus again; with --verify re-execute control and compare every bit."""

    run_dir: tyro.conf.Positional[Path] = Path("runs/latest")
    """Folder of the run."""
    verify: bool = False
    """Re-execute control from the journal; 0 if bit-identical, 1 at the first difference."""
    speed: float = 1.0
    """Of playing; 2: twice as fast."""
    url: str = ""
    """LCM URL to play on."""
    json: bool = False
    """Print the verdict as one JSON object."""

    def run(self) -> int:
        """Replay."""
        from downbeat.tools.replay import play_log, verify_command

        if self.verify:
            return verify_command(self.run_dir, self.json)
        return play_log(self.run_dir, self.url, self.speed)


@dataclass(frozen=True)
class Traffic:
    """Play a traffic scenario (lost, late, broken, forged messages) and judge the reaction."""

    scenario: tyro.conf.Positional[Path]
    """TOML file; tests/scenarios has more than a hundred."""
    url: str = ""
    """Publish its requests and injections on this bus; omitted: lockstep with control and plant."""
    json: bool = False
    """Print the outcome as one JSON object."""

    def run(self) -> int:
        """Play; 0 if everything happened as expected."""
        from downbeat.tools.traffic import traffic_command

        return traffic_command(self.scenario, self.url, self.json)


@dataclass(frozen=True)
class Report:
    """Compute metrics.json and timeline.png of a run again, from its log and truth file alone."""

    run_dir: tyro.conf.Positional[Path] = Path("runs/latest")
    """Folder of the run."""
    video: bool = False
    """Also render video.mp4."""
    json: bool = False
    """Print metrics as one JSON object on standard output."""

    def run(self) -> int:
        """Compute and print."""
        from downbeat.tools.finish import report_command

        return report_command(self.run_dir, self.video, self.json)


@dataclass(frozen=True)
class Spy:
    """Build the Java types jar (cached) and start lcm-spy with it."""

    url: str = ""
    """LCM URL."""

    def run(self) -> int:
        """Run lcm-spy until it is closed."""
        from downbeat.tools.operator import spy

        return spy(self.url)


@dataclass(frozen=True)
class Doctor:
    """Check this machine: versions, LCM, buffers, real-time rights, sound, DDS, the robot."""

    url: str = ""
    """LCM URL."""
    interface: str = ""
    """Network interface to a robot, to see whether it is there; omitted: not looked for."""
    domain: int = 0
    """Its DDS domain."""
    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> int:
        """Check; 0 if nothing fails."""
        from downbeat.tools.operator import doctor

        return doctor(self.url, self.json, self.interface, self.domain)


@dataclass(frozen=True)
class Bench:
    """Print what things cost here; `control`: the control loop against the clock and a C loop."""

    what: tyro.conf.Positional[
        Literal["table", "control", "bridge", "check", "batch", "speech"]
    ] = "table"
    """table: tick, codec, fingerprint query, generator, lockstep speed; control: real time;
    bridge: latency, loss and processor time between DDS and LCM; check: an online check beside the
    bare physics of the same steps; batch: physics steps per second of the batch engines; speech:
    from the end of an utterance to the request, and what recognisers cost."""
    only: tuple[str, ...] = ()
    """table: names of benchmarks; none: all."""
    seconds: float = 14.0
    """control, bridge: time for each block, idle and again loaded [s]."""
    load: bool = True
    """control, bridge: measure also beside one busy loop per processor."""
    skill: str = "kpop"
    """control: the planted skill to play."""
    cpu: int | None = None
    """control: pin control and the C loop to this processor."""
    url: str = ""
    """control: LCM URL; empty: a free port on this machine only."""
    whisper: str = ""
    """speech: folder of Whisper weights to measure with (extra: models)."""
    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> int:
        """Measure and print."""
        if self.what == "control":
            from downbeat.tools.bench_control import ControlBench, bench_control

            bench = ControlBench(self.seconds, self.load, self.skill, self.url, self.cpu)
            return bench_control(bench, self.json)
        if self.what == "bridge":
            from downbeat.tools.bench_bridge import bench_bridge

            return bench_bridge(self.seconds, self.load, self.json)
        if self.what == "check":
            from downbeat.tools.bench_check import bench_check

            return bench_check(self.json)
        if self.what == "speech":
            from downbeat.tools.bench_speech import bench_speech

            return bench_speech(self.json, self.whisper)
        if self.what == "batch":
            from downbeat.tools.bench_batch import bench_batch

            return bench_batch(self.json)
        from downbeat.tools.bench import run_bench

        return run_bench(self.only, self.json)


@dataclass(frozen=True)
class Budget:
    """Hold what a run cost (processor, memory, rates, jitter) against a table of budgets."""

    run_dir: tyro.conf.Positional[Path] = Path("runs/latest")
    """Folder of the run."""
    table: Path | None = None
    """Budgets as TOML; omitted: catalog/budget.toml."""
    json: bool = False
    """Print one JSON object on standard output."""

    def run(self) -> int:
        """Compare; 1 if anything is over its budget."""
        from downbeat.tools.budget import budget_command

        return budget_command(self.run_dir, self.table, self.json)


@dataclass(frozen=True)
class Export:
    """Export: the robot model as MJCF."""

    what: tyro.conf.Positional[Literal["mjcf"]] = "mjcf"
    """What to export."""
    out: Path = Path("g1.xml")
    """File to write."""

    def run(self) -> int:
        """Write it."""
        from downbeat.catalog.mjcf import g1_mjcf

        self.out.write_text(g1_mjcf(), encoding="utf-8")
        print(self.out)
        return 0
