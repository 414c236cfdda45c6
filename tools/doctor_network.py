"""The doctor's network checks: LCM, multicast, buffers, other publishers."""

from __future__ import annotations

import ipaddress
import re
import socket
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import lcm

from downbeat.runtime.bus import MulticastError, foreign_traffic, parse_udpm_url
from downbeat.runtime.udpm import RECV_BUF_SIZE, UdpmUrl, check_multicast
from downbeat.tools.doctor_check import CheckResult, fail, ok, warn

OLDEST_LCM = (1, 5, 3)
IFF_UP = 1
LISTEN_S = 1.0
SELF_TEST_CHANNEL = "DOCTOR_SELF_TEST"
SELF_TEST_BURSTS = ((1000, 412), (100, 100_000))
"""(messages, bytes): the state message at its rate, and a bulk message."""


def check_lcm_version() -> CheckResult:
    """LCM must be one that survives a malformed fragment."""
    version = metadata.version("lcm")
    numbers = tuple(int(part) for part in re.findall(r"\d+", version)[:3])
    if numbers >= OLDEST_LCM:
        return ok("lcm version", version)
    return fail(
        "lcm version",
        f"{version} crashes on a malformed fragment",
        "Install the lcm of constraints.txt.",
    )


def check_url(url: UdpmUrl) -> CheckResult:
    """A show stays on this machine unless somebody wants otherwise."""
    if url.ttl == 0:
        return ok("lcm url", url.text())
    return warn(
        "lcm url",
        f"{url.text()} leaves this machine",
        "Use ttl=0 unless the robot is on that network.",
    )


def check_loopback(flags_file: Path = Path("/sys/class/net/lo/flags")) -> CheckResult:
    """The loopback interface must be up."""
    try:
        is_up = bool(int(flags_file.read_text(), 16) & IFF_UP)
    except OSError:
        return warn("loopback", "its state cannot be read", "Check with `ip link show lo`.")
    if is_up:
        return ok("loopback", "up")
    return fail("loopback", "down", "ip link set lo up")


def check_route(url: UdpmUrl, route_file: Path = Path("/proc/net/route")) -> CheckResult:
    """The group, and its neighbour for audio, need a route, best over the loopback interface."""
    fix = f"ip route add {url.both_groups} dev lo"
    try:
        check_multicast(url)
        check_multicast(url.audio)
    except MulticastError as error:
        return fail("multicast route", str(error.__cause__), fix)
    interface = route_interface(url.group, route_file.read_text())
    if interface in ("", "lo"):
        return ok("multicast route", f"{url.group} over {interface or 'a local route'}")
    return warn(
        "multicast route",
        f"{url.group} over {interface}: works until its cable or address goes",
        fix,
    )


def route_interface(address: str, table: str) -> str:
    """Find the interface of an address in the text of /proc/net/route; empty if none."""
    wanted = int(ipaddress.IPv4Address(address))
    best_mask, best = -1, ""
    for line in table.splitlines()[1:]:
        columns = line.split()
        if len(columns) < 8:
            continue
        # Addresses are printed as little-endian hexadecimal.
        destination, mask = (
            int.from_bytes(bytes.fromhex(columns[index]), "little") for index in (1, 7)
        )
        if wanted & mask == destination and mask > best_mask:
            best_mask, best = mask, columns[0]
    return best


def check_receive_buffer(
    limit_file: Path = Path("/proc/sys/net/core/rmem_max"),
) -> CheckResult:
    """The kernel must grant the receive buffer that we ask for."""
    fix = f"sysctl -w net.core.rmem_max={RECV_BUF_SIZE}"
    try:
        limit = int(limit_file.read_text())
    except OSError:
        return warn("receive buffer", "net.core.rmem_max cannot be read", fix)
    if limit >= RECV_BUF_SIZE:
        return ok("receive buffer", f"up to {limit} bytes")
    return warn(
        "receive buffer", f"up to {limit} bytes: a process that sleeps may lose messages", fix
    )


@dataclass(frozen=True, slots=True)
class SelfTest:
    """What came through between two processes.

    Attributes:
        sent: Messages sent.
        received: Messages that arrived.
        latencies_us: One per message [us].
        buffer_errors: Datagrams that the kernel dropped meanwhile, machine-wide.
    """

    sent: int
    received: int
    latencies_us: list[float]
    buffer_errors: int


def check_two_processes() -> CheckResult:
    """Another process's messages must arrive, all of them."""
    try:
        result = self_test()
    except MulticastError as error:
        return fail("two processes", str(error.__cause__ or error), "See the route above.")
    if result.received == 0:
        return fail(
            "two processes",
            f"none of {result.sent} messages arrived",
            "Allow UDP to 239.0.0.0/8 on lo in the firewall.",
        )
    ordered = sorted(result.latencies_us)
    detail = (
        f"{result.received}/{result.sent} arrived, p50 {statistics.median(ordered):.0f} us, "
        f"p99 {ordered[int(0.99 * (len(ordered) - 1))]:.0f} us, "
        f"{result.buffer_errors} buffer errors"
    )
    if result.received == result.sent:
        return ok("two processes", detail)
    return warn("two processes", detail, f"sysctl -w net.core.rmem_max={RECV_BUF_SIZE}")


def self_test(timeout_s: float = 15.0) -> SelfTest:
    """Receive two bursts from a second process, on a port of their own.

    Raises:
        MulticastError: There is no multicast.
    """
    url = parse_udpm_url(f"udpm://239.255.76.67:{_free_port()}?ttl=0")
    check_multicast(url)
    latencies: list[float] = []

    def arrived(_channel: str, payload: bytes) -> None:
        sent_ns = int.from_bytes(payload[:8], "big")
        latencies.append((time.monotonic_ns() - sent_ns) * 1e-3)

    link = lcm.LCM(url.text())
    link.subscribe(SELF_TEST_CHANNEL, arrived).set_queue_capacity(0)
    errors_before = receive_buffer_errors()
    command = [sys.executable, "-m", "downbeat.tools.doctor_network", url.text()]
    sender = subprocess.Popen(command)
    sent = sum(count for count, _ in SELF_TEST_BURSTS)
    end = time.monotonic() + timeout_s
    while len(latencies) < sent and time.monotonic() < end:
        is_quiet = not link.handle_timeout(300)
        if is_quiet and sender.poll() is not None:
            break
    sender.kill()
    sender.wait()
    return SelfTest(sent, len(latencies), latencies, receive_buffer_errors() - errors_before)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return min(int(probe.getsockname()[1]), 65_533)


def receive_buffer_errors(snmp_file: Path = Path("/proc/net/snmp")) -> int:
    """Return how many UDP datagrams the kernel has dropped for want of buffer."""
    lines = [line.split() for line in snmp_file.read_text().splitlines() if line[:4] == "Udp:"]
    if len(lines) < 2 or "RcvbufErrors" not in lines[0]:
        return 0
    return int(lines[1][lines[0].index("RcvbufErrors")])


def send_bursts(url: str) -> None:
    """Be the second process of the self test: paced as a busy robot would be."""
    link = lcm.LCM(url)
    for count, size in SELF_TEST_BURSTS:
        for _ in range(count):
            stamp = time.monotonic_ns().to_bytes(8, "big")
            link.publish(SELF_TEST_CHANNEL, stamp + bytes(size - len(stamp)))
            time.sleep(0.001)


def check_others(url: UdpmUrl) -> CheckResult:
    """Nobody else may publish on the group: another robot or simulation would be obeyed."""
    try:
        heard = foreign_traffic(url.text(), LISTEN_S)
    except MulticastError as error:
        return fail("other publishers", str(error.__cause__ or error), "See the route above.")
    if not heard:
        return ok("other publishers", "none")
    channels = ", ".join(f"{name} ({count})" for name, count in heard.items())
    return warn("other publishers", channels, "Stop them, or give --url another port.")


if __name__ == "__main__":
    send_bursts(sys.argv[1])
