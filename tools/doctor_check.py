"""What a check of `downbeat doctor` returns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One line of the doctor's table.

    Attributes:
        name: What was checked.
        status: "ok", "warn" (works, with a risk) or "fail" (a show in real time will not work).
        detail: What was found.
        fix: What to type or install; empty if ok.
    """

    name: str
    status: Literal["ok", "warn", "fail"]
    detail: str
    fix: str = ""


def ok(name: str, detail: str) -> CheckResult:
    """All is well."""
    return CheckResult(name, "ok", detail)


def warn(name: str, detail: str, fix: str) -> CheckResult:
    """It works, with a risk."""
    return CheckResult(name, "warn", detail, fix)


def fail(name: str, detail: str, fix: str) -> CheckResult:
    """It does not work."""
    return CheckResult(name, "fail", detail, fix)
