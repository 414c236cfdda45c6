"""What one recogniser costs in a process of its own: real-time factor and memory, as JSON."""

from __future__ import annotations

import json
import os
import sys
import time

from downbeat.perception.errors import PerceptionError
from downbeat.perception.grounding import NOT_BY_VOICE
from downbeat.perception.recognisers import SAMPLE_RATE_HZ, RecogniserConfig, make_recogniser
from downbeat.perception.reply_table import QUESTIONS
from downbeat.policies.manifest import load_skills
from downbeat.runtime.usage import own_usage
from downbeat.tools.onstage import speak
from downbeat.tools.spoken_lines import COMMANDS, VOICES


def measure(backend: str, url: str, model: str, count: int) -> dict[str, float | str]:
    """Return load time, real-time factors (wall clock and processor) and memory [MiB].

    Args:
        backend: Of `recognisers.BACKENDS`.
        url: Of a service.
        model: Of a service, or a folder of weights.
        count: Utterances.
    """
    sounds = [speak(text, VOICES[0], SAMPLE_RATE_HZ) for text, _ in COMMANDS[:count]]
    said = [
        text
        for name, one in load_skills().items()
        if name not in NOT_BY_VOICE
        for text in one.phrases
    ]
    before_kb, begin = own_usage().memory_kb, time.perf_counter()
    config = RecogniserConfig(backend, url, model)
    try:
        recogniser = make_recogniser(config, [*said, *QUESTIONS], {})
    except PerceptionError as error:
        return {"backend": backend, "missing": str(error)}
    load_s = time.perf_counter() - begin
    recogniser.recognise(sounds[0])  # the first one warms up
    begin, begin_cpu = time.perf_counter(), time.process_time()
    failures = [recogniser.recognise(sound).failure for sound in sounds]
    wall_s, cpu_s = time.perf_counter() - begin, time.process_time() - begin_cpu
    heard_s = sum(map(len, sounds)) / SAMPLE_RATE_HZ
    return {
        "backend": backend,
        "load_s": round(load_s, 2),
        "real_time_factor": round(wall_s / heard_s, 4),
        "processor_factor": round(cpu_s / heard_s, 4),
        "memory_mib": round((own_usage().memory_kb - before_kb) / 1024, 1),
        "failure": next(filter(None, failures), ""),
    }


if __name__ == "__main__":
    result = measure(sys.argv[1], sys.argv[2], sys.argv[3], int(sys.argv[4]))
    print(json.dumps(result), flush=True)
    os._exit(0)  # libraries of models may wait for their threads at the end
