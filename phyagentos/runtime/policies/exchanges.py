"""What a policy was shown and what it answered, in the evidence bundle, and how to show it again.

`policy.jsonl` has one line for each chunk. The observations and the rows of one are a zip file that bears the hash of
its bytes, `policy-<hash>.zip`: pictures as PNG, other arrays as `.npy`. numpy and any zip reader suffice to read it.
"""

import hashlib
import io
import time
import zipfile
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.evidence import POLICY, POLICY_PREFIX
from phyagentos.runtime.perception.look_file import read_array, write_array
from phyagentos.runtime.policies import wire

ROWS = "rows"  # of the chunk, beside the observations by their names

Array = NDArray[Any]


class Exchange(msgspec.Struct, frozen=True, kw_only=True):
    """One line of `policy.jsonl`.

    Attributes:
        sequence: Of the request, from 0.
        rows_done: Control periods commanded before it.
        time_s: Of the observations, in the target's time [s].
        wall_s: From the request to the chunk, by the wall [s].
        done: Whether the policy had nothing to do after these rows.
        file: Of the arrays, within the bundle.
        sha256: Of its bytes.
    """

    sequence: int
    rows_done: int
    time_s: float
    wall_s: float
    done: bool
    file: str
    sha256: str


class ExchangeLog:
    """Writes the exchanges of one session, in a thread of its own: compression takes longer than a control period."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="policy-log")
        self._asked: tuple[wire.Infer, float] | None = None
        self._written: list[Future[None]] = []
        (folder / POLICY).write_bytes(b"")

    def show(self, request: wire.Infer) -> None:
        """A request is on its way."""
        self._asked = request, time.perf_counter()

    def answer(self, chunk: wire.Chunk) -> None:
        """It was answered."""
        if self._asked is not None:
            request, began_s = self._asked
            wall_s = time.perf_counter() - began_s
            self._written.append(self._thread.submit(self._write, request, chunk, wall_s))

    def close(self) -> None:
        """Wait for what is being written; raises OSError where something could not be."""
        self._thread.shutdown(wait=True)
        for each in self._written:
            each.result()

    def _write(self, request: wire.Infer, chunk: wire.Chunk, wall_s: float) -> None:
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as kept:
            for name, array in (dict(request.observations) | {ROWS: chunk.rows}).items():
                write_array(kept, name, array)
        sha256 = hashlib.sha256(buffer.getvalue()).hexdigest()
        file = f"{POLICY_PREFIX}{sha256[:16]}.zip"
        (self._folder / file).write_bytes(buffer.getvalue())
        exchange = Exchange(
            sequence=request.sequence,
            rows_done=request.rows_done,
            time_s=request.time_s,
            wall_s=round(wall_s, 6),
            done=chunk.done,
            file=file,
            sha256=sha256,
        )
        with (self._folder / POLICY).open("ab") as lines:
            lines.write(msgspec.json.encode(exchange) + b"\n")


def read_exchanges(folder: Path) -> tuple[Exchange, ...]:
    """The exchanges of a bundle; raises ExecutionError `EVIDENCE_UNREADABLE` where there are none."""
    try:
        lines = (folder / POLICY).read_bytes().splitlines()
        return tuple(msgspec.json.decode(line, type=Exchange) for line in lines)
    except (OSError, msgspec.MsgspecError) as error:
        raise ExecutionError("EVIDENCE_UNREADABLE", f"{folder / POLICY}: {error}") from error


def read_arrays(folder: Path, exchange: Exchange) -> tuple[dict[str, Array], Array]:
    """The observations of an exchange, and its rows; raises ExecutionError `EVIDENCE_UNREADABLE`."""
    path = folder / exchange.file
    try:
        data = path.read_bytes()
        if hashlib.sha256(data).hexdigest() != exchange.sha256:
            raise ValueError(f"its bytes are not those of sha256 {exchange.sha256}")
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            arrays = {Path(name).stem: read_array(file, name) for name in file.namelist()}
        return arrays, arrays.pop(ROWS)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise ExecutionError("EVIDENCE_UNREADABLE", f"{path}: {error}") from error
