"""A policy that is an ONNX model, run in this process by onnxruntime (the extra `onnx`).

Its inputs bear the keys of the observations, with or without a first axis of length one; its first output, or the one
named `actions`, is the chunk; one named `done`, if there is one, is true with the last chunk.
"""

from pathlib import Path
from typing import Any

import numpy as np

from phyagentos.errors import ExecutionError, format_install, format_names
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.openpi_codec import ACTIONS, PROMPT

TYPES = {"float": "float32", "double": "float64", "string": "str"}  # of ONNX that numpy has under another name
DONE = "done"


class OnnxPolicy:
    """A `Policy` without memory; one thread computes it, so that the same observation gives the same bits.

    Raises:
        ExecutionError: `POLICY_UNREACHABLE` where there is no such model, or no onnxruntime.
    """

    def __init__(self, path: Path) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise ExecutionError(
                "POLICY_UNREACHABLE", message=f"{path}: no onnxruntime here. {format_install('onnx')}"
            ) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        try:
            data = path.read_bytes()
            self._session: Any = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its errors have no common root
            raise ExecutionError("POLICY_UNREACHABLE", f"{path} is no model that runs here: {error}") from error
        self._outputs = [each.name for each in self._session.get_outputs()]
        self._instruction = ""

    def start(self, request: wire.Start) -> None:
        """A session begins."""
        self._instruction = request.instruction

    def infer(self, request: wire.Infer) -> tuple[wire.Array, bool]:
        """Rows of the next chunk; raises ValueError for an input that no observation has."""
        shown = {PROMPT: np.array(self._instruction), **request.observations}
        fed = {each.name: _prepare(each, shown) for each in self._session.get_inputs()}
        given = dict(zip(self._outputs, self._session.run(None, fed), strict=True))
        rows = np.asarray(given.get(ACTIONS, given[self._outputs[0]]), dtype=np.float64)
        while rows.ndim > 2 and rows.shape[0] == 1:
            rows = rows[0]
        return np.atleast_2d(rows), bool(np.any(given.get(DONE, False)))


def _prepare(put: Any, shown: Fields) -> Any:
    if put.name not in shown:
        raise ValueError(f"the model takes {put.name!r}; it is shown {format_names(shown)}")
    kind = put.type.removeprefix("tensor(").removesuffix(")")
    value = np.asarray(shown[put.name]).astype(TYPES.get(kind, kind))
    return value[None] if value.ndim == len(put.shape) - 1 else value
