"""Opens ONNX files the one way that Downbeat runs policies: one thread, fixed optimisation level.

The level is pinned because it changes bits (measured on LayerNorm and MatMul+Add nets); one thread
without spinning because a spinning pool steals the core that the next tick needs.
"""

from __future__ import annotations

from pathlib import Path

import onnxruntime as ort

from downbeat.control.errors import ControlError

WARM_UP_CALLS = 10
"""The first calls of a session allocate; they must not happen inside a tick."""


def open_session(path: Path) -> ort.InferenceSession:
    """Open a policy.

    Raises:
        ControlError: The file is missing or is not a valid ONNX model.
    """
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    try:
        return ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises a dozen types of its own
        raise ControlError(f"Policy {path} cannot be loaded: {error}") from error
