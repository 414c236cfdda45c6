"""`downbeat doctor`: is this machine fit for a show? One function per check."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from downbeat.runtime.bus import BusError, parse_udpm_url
from downbeat.tools import doctor_machine, doctor_network
from downbeat.tools.doctor_check import CheckResult, fail

Check = Callable[[], CheckResult]


def checks_for(url: str) -> list[tuple[str, Check]]:
    """Return the checks in the order in which they make sense.

    Args:
        url: LCM URL; empty: the show's default group.

    Raises:
        BusError: The URL is not one.
    """
    parsed = parse_udpm_url(url)
    return [
        ("lcm version", doctor_network.check_lcm_version),
        ("lcm url", partial(doctor_network.check_url, parsed)),
        ("loopback", doctor_network.check_loopback),
        ("multicast route", partial(doctor_network.check_route, parsed)),
        ("receive buffer", doctor_network.check_receive_buffer),
        ("two processes", doctor_network.check_two_processes),
        ("other publishers", partial(doctor_network.check_others, parsed)),
        ("scheduling", doctor_machine.check_scheduling),
        ("rt throttling", doctor_machine.check_rt_throttling),
        ("memory lock", doctor_machine.check_memory_lock),
        ("cpu governor", doctor_machine.check_governor),
        ("stolen cpu", doctor_machine.check_steal),
        ("control imports", doctor_machine.check_control_imports),
        ("rendering", doctor_machine.check_rendering),
        ("java", doctor_machine.check_java),
    ]


def run_doctor(url: str = "") -> list[CheckResult]:
    """Run every check; one that breaks is a failed check, not an exception.

    Args:
        url: LCM URL; empty: the show's default group.
    """
    try:
        checks = checks_for(url)
    except BusError as error:
        return [fail("lcm url", str(error), "Give a udpm URL, or none for the default.")]
    results: list[CheckResult] = []
    for name, check in checks:
        try:
            results.append(check())
        except (OSError, ValueError, RuntimeError) as error:
            results.append(fail(name, f"The check broke: {error}", "Report this."))
    return results


def is_healthy(results: list[CheckResult]) -> bool:
    """Whether nothing fails; warnings are allowed."""
    return all(result.status != "fail" for result in results)
