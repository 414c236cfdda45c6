"""The bus: messages by channel, checked both ways, counted, never raised out of a handler.

`open_udpm` is LCM over UDP multicast, `MemqHub` the same inside one process for lockstep,
`downbeat.runtime.log.LogBus` reads a recorded log.
"""

from __future__ import annotations

from downbeat.runtime.bus_types import Bus, BusCounters, BusError, Freshness, Received
from downbeat.runtime.memq import MemqEndpoint, MemqHub
from downbeat.runtime.udpm import (
    DEFAULT_URL,
    MulticastError,
    UdpmBus,
    foreign_traffic,
    open_udpm,
    parse_udpm_url,
)

__all__ = [
    "DEFAULT_URL",
    "Bus",
    "BusCounters",
    "BusError",
    "Freshness",
    "MemqEndpoint",
    "MemqHub",
    "MulticastError",
    "Received",
    "UdpmBus",
    "foreign_traffic",
    "open_udpm",
    "parse_udpm_url",
]
