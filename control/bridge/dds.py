"""The robot's bus: raw bytes in and out of Cyclone DDS; needs the extra `g1`.

The library turns every sample into a tree of Python objects, 0.3 ms for a LowState. Nobody here
wants the tree: readers hand out the bytes as they came, writers take bytes, and
`downbeat.control.bridge.layout` knows where the numbers lie in them.
"""

from __future__ import annotations

import ctypes
import time
from typing import Any

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsPublication,
)
from cyclonedds.core import (
    DDSException,
    GuardCondition,
    InstanceState,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import DDS
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from downbeat.control.bridge.dds_config import DdsError, check_domain, domain_config

ANY_STATE = int(SampleState.Any | ViewState.Any | InstanceState.Any)
_WAIT: Any = ctypes.CFUNCTYPE(
    ctypes.c_int32, ctypes.c_int32, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int64
)(("dds_waitset_wait", DDS._dll_handle))
"""The library's own `wait` without its checks of arguments: 500 calls a second."""
KEPT_SAMPLES = 32
"""A reader keeps this many: 64 ms of states, so that a gap is a gap and not our own delay."""
TAKEN_AT_ONCE = 4
"""One is there as a rule; the library makes room for as many as one asks for."""


class RawReader:
    """Samples of one topic as the bytes that came, encapsulation first."""

    def __init__(self, participant: Any, topic: str, data_type: Any, ignore_own: bool = False):
        """Subscribe, best effort, as the vendor's own readers do.

        Args:
            participant: Where.
            topic: DDS topic name.
            data_type: Its IDL type.
            ignore_own: Do not hear writers of the same participant.
        """
        policies = [Policy.History.KeepLast(KEPT_SAMPLES)]
        if ignore_own:
            policies.append(Policy.IgnoreLocal.Participant)
        self._topic = Topic(participant, topic, data_type)
        self._reader = DataReader(participant, self._topic, qos=Qos(*policies))
        self._ref = self._reader._ref
        self.condition = ReadCondition(
            self._reader, SampleState.NotRead | ViewState.Any | InstanceState.Any
        )

    def take(self) -> list[bytes]:
        """Return what has come since the last take, oldest first; never raises."""
        samples: list[bytes] = []
        while True:
            taken = ddspy_take(self._ref, ANY_STATE, TAKEN_AT_ONCE)
            if isinstance(taken, int):
                return samples
            samples += [data for data, info in taken if info.valid_data]
            if len(taken) < TAKEN_AT_ONCE:
                return samples


class RawWriter:
    """Writes samples of one topic given as bytes."""

    def __init__(self, participant: Any, topic: str, data_type: Any) -> None:
        self._topic = Topic(participant, topic, data_type)
        self._writer = DataWriter(participant, self._topic)
        self._ref = self._writer._ref
        self.not_sent = 0

    def write(self, payload: bytes) -> None:
        """Send one sample (CDR with encapsulation, length a multiple of 4); counts failures."""
        if ddspy_write(self._ref, payload) < 0:
            self.not_sent += 1

    def num_readers(self) -> int:
        """Return how many readers are matched now."""
        return len(self._writer.get_matched_subscriptions())


class Link:
    """One participant on one interface, and the place where a process waits for it."""

    def __init__(self, interface: str, domain: int) -> None:
        """Join a domain.

        Args:
            interface: Network interface, given explicitly: a robot is never guessed.
            domain: DDS domain; the robot's own is 0.

        Raises:
            DdsError: No such interface or domain, or DDS cannot use it.
        """
        check_domain(domain)
        config = domain_config(interface)
        try:
            self._domain: Any = Domain(domain, config)
            self.participant: Any = DomainParticipant(domain)
        except DDSException as error:
            raise DdsError(
                f"DDS cannot use interface {interface!r} in domain {domain}: {error.msg or error}. "
                "Check that the interface is up and has an address."
            ) from error
        self._waitset: Any = WaitSet(self.participant)
        self._guard: Any = GuardCondition(self.participant)
        self._waitset.attach(self._guard)
        self.was_woken = False
        self._is_set = False
        self._publications: Any = None
        self._own_key = str(self.participant.guid)

    def reader(self, topic: str, data_type: Any, ignore_own: bool = False) -> RawReader:
        """Subscribe to a topic."""
        return RawReader(self.participant, topic, data_type, ignore_own)

    def writer(self, topic: str, data_type: Any) -> RawWriter:
        """Publish a topic."""
        return RawWriter(self.participant, topic, data_type)

    def wake_on(self, reader: RawReader) -> None:
        """Have `wait` return when this reader has something."""
        self._waitset.attach(reader.condition)

    def wait(self, timeout_s: float) -> None:
        """Wait until a reader has something, somebody calls `wake`, or the time is over."""
        if timeout_s > 0.0 and not self._is_set:
            _WAIT(self._waitset._ref, None, 0, int(timeout_s * 1e9))
        if self._is_set:
            self._is_set = False
            self._guard.set(False)

    def wake(self) -> None:
        """End a `wait`; may be called from another thread."""
        self.was_woken = self._is_set = True
        self._guard.set(True)

    def publishers_of(self, topic: str) -> int:
        """Return how many writers of a topic other participants have announced so far."""
        if self._publications is None:
            self._publications = BuiltinDataReader(self.participant, BuiltinTopicDcpsPublication)
            time.sleep(0.1)
        found = set()
        for sample in self._publications.read(1000):
            name = getattr(sample, "topic_name", "")
            if name == topic and str(sample.participant_key) != self._own_key:
                found.add(str(sample.key))
        return len(found)

    def close(self) -> None:
        """Leave the domain; everything made here is gone then."""
        # Entities would go one by one, in the order in which Python happens to forget them.
        self.participant._delete(self.participant._ref)
