"""Cyclone DDS settings for one interface, and the port that LCM and DDS can fight over."""

from __future__ import annotations

import socket

from downbeat.control.errors import ControlError
from downbeat.runtime.errors import one_of

LOOPBACK = "lo"
DOMAIN_PORTS = 250
FIRST_PORT = 7400
"""RTPS: a domain's ports begin at 7400 + 250 domain; participant i has 10 + 2 i and 11 + 2 i."""
MAX_DOMAIN = 232

_XML = """<CycloneDDS><Domain Id="any"><General>
<Interfaces><NetworkInterface name="{interface}" multicast="{multicast}"/></Interfaces>
<AllowMulticast>{allow}</AllowMulticast></General>
<Discovery>{discovery}</Discovery></Domain></CycloneDDS>"""


class DdsError(ControlError):
    """DDS cannot be used as asked; the message says what would work."""


def domain_config(interface: str) -> str:
    """Return the Cyclone DDS configuration for an interface.

    On the loopback interface some versions announce themselves by multicast and others, which hold
    it for unable, by unicast: there we do both, and take a numbered participant so that unicast
    announcements find us.

    Args:
        interface: Network interface, e.g. "eth0" or "lo".

    Raises:
        DdsError: There is no such interface.
    """
    names = [name for _index, name in socket.if_nameindex()]
    if interface not in names:
        raise DdsError(
            f"Network interface {interface!r} does not exist; this machine has {one_of(names)} "
            "(--interface)."
        )
    if interface == LOOPBACK:
        discovery = (
            '<ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers>'
        )
        return _XML.format(interface=interface, multicast="true", allow="spdp", discovery=discovery)
    return _XML.format(interface=interface, multicast="default", allow="default", discovery="")


def check_domain(domain: int) -> None:
    """Refuse a domain number that DDS does not have.

    Raises:
        DdsError: It is not one.
    """
    if not 0 <= domain <= MAX_DOMAIN:
        raise DdsError(f"DDS domain {domain} does not exist; valid are 0 to {MAX_DOMAIN}.")


def port_clash(domain: int, lcm_port: int) -> str:
    """Say when participants of a DDS domain may take LCM's UDP port; empty: they cannot.

    LCM then prints one line and receives nothing, without an exception.

    Args:
        domain: DDS domain.
        lcm_port: Of the LCM URL.
    """
    offset = lcm_port - FIRST_PORT - DOMAIN_PORTS * domain
    if not 10 <= offset < DOMAIN_PORTS:
        return ""
    participant = (offset - 10) // 2 + 1
    return (
        f"participant {participant} of DDS domain {domain} on this machine takes UDP port "
        f"{lcm_port}, which is LCM's; LCM would then receive nothing. Use --domain 0, or another "
        "port in --url"
    )
