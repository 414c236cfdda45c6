"""`downbeat doctor`: is this machine fit for a show? One function per check."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from downbeat.runtime.bus import BusError, parse_udpm_url
from downbeat.tools import doctor_machine, doctor_network, doctor_robot
from downbeat.tools.doctor_check import CheckResult, fail

Check = Callable[[], CheckResult]


def checks_for(url: str, interface: str = "", domain: int = 0) -> list[tuple[str, Check]]:
    """Return the checks in the order in which they make sense.

    Args:
        url: LCM URL; empty: the show's default group.
        interface: Network interface to a robot; empty: none is looked for.
        domain: Its DDS domain.

    Raises:
        BusError: The URL is not one.
    """
    parsed = parse_udpm_url(url)
    return [
        ("versions", doctor_robot.check_versions),
        ("types", doctor_robot.check_types),
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
        ("audio devices", doctor_robot.check_audio),
        ("dds version", doctor_robot.check_dds_version),
        ("dds ports", partial(doctor_robot.check_dds_ports, domain, parsed)),
        ("robot", partial(doctor_robot.check_robot, interface, domain)),
    ]


def run_doctor(url: str = "", interface: str = "", domain: int = 0) -> list[CheckResult]:
    """Run every check; one that breaks is a failed check, not an exception.

    Args:
        url: LCM URL; empty: the show's default group.
        interface: Network interface to a robot; empty: none is looked for.
        domain: Its DDS domain.
    """
    try:
        checks = checks_for(url, interface, domain)
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
