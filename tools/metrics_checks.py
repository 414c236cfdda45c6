"""What the online checks of a run did: asked, simulated, refused, and how long they took."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from downbeat.tools.runlog import RunLog


@dataclass(frozen=True)
class Check:
    """A plan that the checker was asked about before it was made.

    Attributes:
        asked_s: Of the show.
        answered_s: Of the show; None: never.
        late_s: Of the answer, after its deadline [s].
        fallen: Rollouts that fell.
        count: Rollouts; an answer with none says that there was no time for one.
        refused: The plan was not made because rollouts fell.
    """

    asked_s: float
    answered_s: float | None = None
    late_s: float = 0.0
    fallen: int = 0
    count: int = 0
    refused: bool = False

    @property
    def is_simulated(self) -> bool:
        """Whether the answer says anything about the plan; else the atlas stood alone."""
        return self.count > 0

    def text(self) -> str:
        """Return what came of it, e.g. "0/32"."""
        if self.answered_s is None:
            return "no answer"
        return f"{self.fallen}/{self.count}" if self.is_simulated else "no time"


def checks_of(log: RunLog, zero_utime: int) -> list[Check]:
    """Return the plans that were asked about, in order.

    Args:
        log: Of the run.
        zero_utime: The show's zero [us].
    """
    answers = {int(m.query_id): m for m in log.events["TRANSITION_VERDICT"]}
    refusals = [
        (int(m.request_id), m.skill, m.reason)
        for m in log.events["SKILL_STATUS"]
        if m.reason.startswith("not ")
    ]
    found = []
    for query in log.events["TRANSITION_QUERY"]:
        asked_s = (query.header.utime - zero_utime) * 1e-6
        answer = answers.get(int(query.query_id))
        if answer is None:
            found.append(Check(asked_s))
            continue
        fallen, count = int(answer.num_fallen), int(answer.num_rollouts)
        words = f": {fallen} of {count} rollouts from here fell"
        refused = any(
            (request, skill) == (int(query.request_id), query.to_skill) and reason.endswith(words)
            for request, skill, reason in refusals
        )
        found.append(
            Check(
                asked_s=asked_s,
                answered_s=(answer.header.utime - zero_utime) * 1e-6,
                late_s=(answer.header.utime - query.deadline_utime) * 1e-6,
                fallen=fallen,
                count=count,
                refused=count > 0 and refused,
            )
        )
    return found


def checks_report(log: RunLog) -> dict[str, Any]:
    """Return counts, and the time from question to answer [ms] of plans that were simulated."""
    checks = checks_of(log, 0)
    done = [check for check in checks if check.is_simulated]
    latency_s = [check.answered_s - check.asked_s for check in done if check.answered_s is not None]
    late_s = [check.late_s for check in done]
    return {
        "asked": len(checks),
        "simulated": len(done),
        "no_time": sum(c.answered_s is not None and not c.is_simulated for c in checks),
        "unanswered": sum(c.answered_s is None for c in checks),
        "refused": sum(check.refused for check in checks),
        "rollouts": sum(check.count for check in checks),
        "rollouts_fallen": sum(check.fallen for check in checks),
        "latency_ms": round(float(np.median(latency_s)) * 1e3, 1) if done else None,
        "latest_after_deadline_ms": round(max(late_s) * 1e3, 1) if done else None,
    }
