"""`downbeat policy convert`: a TorchScript policy becomes ONNX with explicit state, checked."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from downbeat.policies.errors import PolicyError
from downbeat.policies.importers.torchscript import Converted, convert, find_width, load, reset

STEPS = 50
TOLERANCE = 1e-5


def convert_command(path: Path, out: Path, width: int) -> int:
    """`downbeat policy convert`."""
    module = load(path)
    width = width or find_width(module, path)
    converted = convert(module, width, path)
    worst, largest = largest_difference(module, converted)
    if not worst <= TOLERANCE * max(1.0, largest):
        raise PolicyError(
            f"{path} converted differs from the original by {worst:.2g} over {STEPS} random steps, "
            f"its largest action is {largest:.2g}; at most {TOLERANCE:g} of that is valid; nothing "
            "was written."
        )
    draft = out.with_name(f".{out.name}.draft")
    try:
        draft.write_bytes(converted.model.SerializeToString())
        os.replace(draft, out)
    except OSError as error:
        raise PolicyError(f"{out} cannot be written: {error.strerror or error}.") from error
    print(f"observation {converted.width}, actions {converted.actions}")
    for name, shape in converted.states.items():
        print(f"state {name}_in -> {name}_out {list(shape)}, zeros at the start")
    print(
        f"largest difference to {path.name} over {STEPS} random steps: {worst:.2g} "
        f"(largest action {largest:.2g})"
    )
    print(f"written: {out}")
    return 0


def largest_difference(module: Any, converted: Converted, seed: int = 0) -> tuple[float, float]:
    """Play both from zero state on the same random observations.

    Returns:
        The largest difference of an action, and the largest action of the original.
    """
    import onnxruntime as ort
    import torch

    session = ort.InferenceSession(
        converted.model.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    rng = np.random.default_rng(seed)
    state = {n: np.zeros(shape, np.float32) for n, shape in converted.states.items()}
    outputs = ["actions", *(f"{name}_out" for name in state)]
    buffers = tuple(converted.buffers.values())
    reset(module, buffers)
    worst = largest = 0.0
    for _ in range(STEPS):
        obs = rng.normal(size=(1, converted.width)).astype(np.float32)
        feeds = {"obs": obs, **{f"{name}_in": value for name, value in state.items()}}
        actions, *values = session.run(outputs, feeds)
        state = dict(zip(state, values, strict=True))
        with torch.no_grad():
            wanted = module(torch.from_numpy(obs)).numpy()
        difference = float(np.abs(actions - wanted).max())
        worst = difference if not difference <= worst else worst  # a NaN stays
        largest = max(largest, float(np.abs(wanted).max()))
    reset(module, buffers)
    return worst, largest
