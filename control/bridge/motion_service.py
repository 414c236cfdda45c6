"""The robot's own motion service: it must let go before anybody else commands the motors."""

from __future__ import annotations

from downbeat.control.bridge.rpc import NO_ANSWER, Service

SERVICE = "motion_switcher"
CHECK_MODE, RELEASE_MODE = 1001, 1003
PERIOD_US = 1_000_000
ABSENT_AFTER = 2
"""Unanswered checks until a simulator counts as one without the service."""


class MotionService:
    """Asks once a second who moves the robot; asks it to let go when told to."""

    def __init__(self, service: Service, may_be_absent: bool) -> None:
        """Prepare.

        Args:
            service: The motion switcher.
            may_be_absent: A simulator has none; a robot that does not answer is not commanded.
        """
        self._service = service
        self._may_be_absent = may_be_absent
        self._next_utime = 0
        self._unanswered = 0
        self.active: str | None = None
        """Name of the active motion service, empty: none, None: not known."""
        self._has_released = False

    def update(self, utime: int, release: bool) -> None:
        """Take answers, and ask what is due at `utime` [us].

        Args:
            utime: Now.
            release: The operator wants the active service to let go.
        """
        for answer in self._service.poll():
            if answer.api != CHECK_MODE:
                continue
            if answer.code == 0:
                self._unanswered = 0
                self.active = str(answer.data.get("name", ""))
            elif answer.code == NO_ANSWER:
                self._unanswered += 1
                is_absent = self._may_be_absent and self._unanswered >= ABSENT_AFTER
                self.active = "" if is_absent else None
        if utime < self._next_utime:
            return
        # One request at a time: a service that keeps the last one only would lose the first.
        self._next_utime = utime + PERIOD_US // 2
        if release and self.active and not self._has_released:
            self._service.call(RELEASE_MODE)
        else:
            self._service.call(CHECK_MODE)
        self._has_released = release and not self._has_released
