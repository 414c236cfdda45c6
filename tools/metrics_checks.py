"""What the online checks of a run did: asked, answered, refused, and how long they took."""

from __future__ import annotations

from typing import Any

import numpy as np

from downbeat.tools.runlog import RunLog


def checks_report(log: RunLog) -> dict[str, Any]:
    """Return counts, and the time from question to answer [ms]."""
    answers = {int(m.query_id): m for m in log.events["TRANSITION_VERDICT"]}
    latency_ms, late_ms, done, fallen = [], [], 0, 0
    for query in log.events["TRANSITION_QUERY"]:
        answer = answers.get(int(query.query_id))
        if answer is None:
            continue
        latency_ms.append((answer.header.utime - query.header.utime) * 1e-3)
        late_ms.append((answer.header.utime - query.deadline_utime) * 1e-3)
        done += int(answer.num_rollouts)
        fallen += int(answer.num_fallen)
    refused = sum(
        m.reason.startswith("not ") and "rollouts from here fell" in m.reason
        for m in log.events["SKILL_STATUS"]
    )
    answered = len(latency_ms)
    return {
        "asked": len(log.events["TRANSITION_QUERY"]),
        "answered": answered,
        "refused": int(refused),
        "rollouts": done,
        "rollouts_fallen": fallen,
        "latency_ms": None if not answered else round(float(np.median(latency_ms)), 1),
        "latest_after_deadline_ms": None if not answered else round(max(late_ms), 1),
    }
