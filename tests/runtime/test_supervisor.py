"""The supervisor with real children."""

import os
import signal
import subprocess
import sys
import time

import pytest

from downbeat.runtime.clock import TimeBase
from downbeat.runtime.process import (
    CrashPolicy,
    ProcessError,
    ProcessSpec,
    always,
    both,
    cli_argv,
    either,
    when,
)
from downbeat.runtime.supervisor import Supervisor

SLEEP = "import time; time.sleep(60)"
STUBBORN = "import signal, time; signal.signal(15, signal.SIG_IGN); print(1, flush=True)\n" + SLEEP


def python(code):
    return (sys.executable, "-S", "-c", code)


def spec(name, code, **options):
    return ProcessSpec(name, python(code), **options)


def step_until(supervisor, condition, rounds=400):
    for _ in range(rounds):
        supervisor.step(0.05)
        if condition():
            return
    raise AssertionError(supervisor.snapshot())


def exists(pid):
    """Whether a process runs; a zombie does not."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.fixture
def supervise():
    made = []

    def make(*specs):
        made.append(Supervisor(specs))
        return made[-1]

    yield make
    for supervisor in made:
        supervisor.stop_all()


def test_children_run_and_stop_politely(supervise):
    supervisor = supervise(spec("a", SLEEP), spec("b", SLEEP))
    assert [s.state for s in supervisor.snapshot()] == ["waiting", "waiting"]
    assert supervisor.step(0.05)
    states = supervisor.snapshot()
    assert [s.state for s in states] == ["running", "running"]
    supervisor.stop_all()
    after = supervisor.snapshot()
    assert [(s.state, s.exit_code, s.pid) for s in after] == [("done", -15, 0)] * 2
    assert not any(exists(s.pid) for s in states)


def test_clean_exit_is_no_crash(supervise):
    supervisor = supervise(spec("once", "pass"), spec("a", SLEEP))
    step_until(supervisor, lambda: supervisor.state_of("once").state == "done")
    assert supervisor.step(0.05)
    assert supervisor.state_of("once").restarts == 0


def test_crash_of_a_vital_process_ends_the_show(supervise):
    supervisor = supervise(spec("control", "raise SystemExit(3)"), spec("a", SLEEP))
    report = supervisor.run(should_stop=lambda: False)
    assert not report.is_good and report.reason == "control ended with 3"
    assert [s.state for s in report.processes] == ["failed", "done"]


def test_crashed_process_is_restarted_until_it_is_hopeless(supervise):
    options = {"crash_policy": CrashPolicy.RESTART, "max_restarts": 2, "restart_delay_s": 0.01}
    supervisor = supervise(spec("listener", "raise SystemExit(1)", **options))
    report = supervisor.run(should_stop=lambda: False)
    assert report.reason == "listener ended with 1 after 2 restarts"
    assert report.processes[0].restarts == 2


def test_process_that_may_never_restart_stays_down_and_the_show_goes_on(supervise):
    never = spec("viewer", "raise SystemExit(1)", crash_policy=CrashPolicy.NEVER)
    supervisor = supervise(never, spec("a", SLEEP))
    step_until(supervisor, lambda: supervisor.state_of("viewer").state == "failed")
    assert supervisor.step(0.05)
    assert supervisor.state_of("viewer").restarts == 0
    assert supervisor.state_of("a").state == "running"


def test_child_that_ignores_the_polite_signal_is_killed(supervise, tmp_path):
    log_path = tmp_path / "stubborn.log"
    supervisor = supervise(spec("stubborn", STUBBORN, stop_timeout_s=0.1, log_path=log_path))
    step_until(supervisor, lambda: log_path.exists() and log_path.read_text() == "1\n")
    supervisor.stop_all()
    state = supervisor.state_of("stubborn")
    assert (state.state, state.exit_code) == ("killed", -9)


def test_process_follows_its_condition(supervise):
    supervisor = supervise(spec("view", SLEEP, should_run=when("display")))
    supervisor.step(0.01)
    assert supervisor.state_of("view").state == "waiting"
    supervisor.set_conditions(frozenset({"display"}))
    supervisor.step(0.01)
    assert supervisor.state_of("view").state == "running"
    supervisor.set_conditions(frozenset())
    step_until(supervisor, lambda: supervisor.state_of("view").state == "done")
    supervisor.set_conditions(frozenset({"display"}))
    supervisor.step(0.01)
    assert supervisor.state_of("view").state == "running"


def test_predicates_combine():
    a, b = when("a"), when("b")
    assert both(a, b)(frozenset("ab")) and not both(a, b)(frozenset("a"))
    assert either(a, b)(frozenset("b")) and not either(a, b)(frozenset())
    assert always(frozenset())


def test_children_die_with_a_killed_supervisor(tmp_path):
    pid_file = tmp_path / "pid"
    child = f"import os; open({str(pid_file)!r}, 'w').write(str(os.getpid())); {SLEEP}"
    code = (
        "import sys\n"
        "from downbeat.runtime.process import ProcessSpec\n"
        "from downbeat.runtime.supervisor import Supervisor\n"
        "spec = ProcessSpec('child', (sys.executable, '-S', '-c', sys.argv[1]))\n"
        "Supervisor([spec]).run(lambda: False)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code, child])
    wait_for(lambda: pid_file.exists() and pid_file.read_text())
    pid = int(pid_file.read_text())
    assert exists(pid)
    os.kill(parent.pid, signal.SIGKILL)
    parent.wait()
    wait_for(lambda: not exists(pid))


def wait_for(condition):
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_program_that_does_not_exist_says_so(supervise, tmp_path):
    log_path = tmp_path / "log"
    supervisor = supervise(ProcessSpec("ghost", ("/no/such/program",), log_path=log_path))
    assert not supervisor.run(should_stop=lambda: False).is_good
    assert "/no/such/program cannot be started" in log_path.read_text()


def test_wrong_tables_are_refused(tmp_path):
    with pytest.raises(ProcessError, match="twice"):
        Supervisor([spec("a", ""), spec("a", "")])
    with pytest.raises(ProcessError, match="no command"):
        Supervisor([ProcessSpec("a", ())])
    with pytest.raises(ProcessError, match="no process 'b'.*it has a"):
        Supervisor([spec("a", "")]).state_of("b")
    with pytest.raises(ProcessError, match="cannot be started"):
        Supervisor([spec("a", "", log_path=tmp_path / "no" / "log")]).step()


def test_our_own_processes_get_the_time_base():
    argv = cli_argv("control", "--show", "x.toml", base=TimeBase(5, 7))
    assert argv[1:4] == ("-m", "downbeat.tools.cli", "control")
    assert argv[4:] == ("--show", "x.toml", "--epoch-utime", "5", "--epoch-monotonic-ns", "7")
