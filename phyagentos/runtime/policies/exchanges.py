"""What a policy was shown and what it answered, in the evidence bundle, and how to show it again.

`policy.jsonl` has one line for each chunk. The observations and the rows of one are a zip file that bears the hash of
its bytes, `policy-<hash>.zip`: pictures as PNG, other arrays as `.npy`. numpy and any zip reader suffice to read it.
"""

import contextlib
import hashlib
import io
import time
import zipfile
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.registries import locate_models, read_skill_registry
from phyagentos.protocol.documents.packed_files import open_packed
from phyagentos.protocol.documents.schema import parse_yaml, read_text
from phyagentos.protocol.sessions.evidence import CONTRACT, POLICY, POLICY_PREFIX
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.perception.look_file import read_array, write_array
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.client import PolicyClient

ROWS = "rows"  # of the chunk, beside the observations by their names

Array = NDArray[Any]
WAIT_S = 0.5
SAME = 1e-9  # of a number of a row: more is another answer


class Exchange(msgspec.Struct, frozen=True, kw_only=True):
    """One line of `policy.jsonl`: request number `sequence`, from 0, after so many control periods were commanded.

    `time_s` is of the observations, in the target's time [s], `wall_s` from the request to the chunk [s]; `file` has
    the arrays, within the bundle, with `sha256` of its bytes.
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
            self._written.append(self._thread.submit(self._write, request, chunk, time.perf_counter() - began_s))

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
    """The exchanges of a bundle; raises ExecutionError `EVIDENCE_DAMAGED` where there are none."""
    try:
        lines = (folder / POLICY).read_bytes().splitlines()
        return tuple(msgspec.json.decode(line, type=Exchange) for line in lines)
    except (OSError, msgspec.MsgspecError) as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{folder / POLICY}: {error}") from error


def read_arrays(folder: Path, exchange: Exchange) -> tuple[dict[str, Array], Array]:
    """The observations of an exchange, and its rows; raises ExecutionError `EVIDENCE_DAMAGED`."""
    path = folder / exchange.file
    try:
        data = path.read_bytes()
        if hashlib.sha256(data).hexdigest() != exchange.sha256:
            raise ValueError(f"its bytes are not those of sha256 {exchange.sha256}")
        with open_packed(data) as file:
            arrays = {Path(name).stem: read_array(file, name) for name in file.names}
        return arrays, arrays.pop(ROWS)
    except (OSError, ValueError, KeyError) as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{path}: {error}") from error


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """One chunk beside the recorded one.

    Attributes:
        time_s: Of the observations, in the target's time [s].
        recorded: Shape of the recorded rows; `given` is that of the rows now, empty where there was no chunk.
        difference: Greatest of any number, in the policy's own units, at row and column `where`; else infinite.
        done: Whether the policy says now that it is done, where it said the other object then; None otherwise.
        fault: Why there is no chunk.
    """

    sequence: int
    time_s: float
    recorded: tuple[int, ...]
    given: tuple[int, ...] = ()
    difference: float = float("inf")
    where: tuple[int, ...] = ()
    done: bool | None = None
    fault: str = ""

    @property
    def is_same(self) -> bool:
        """Whether it is the recorded answer."""
        return self.difference <= SAME and self.done is None

    @override
    def __str__(self) -> str:
        if self.fault:
            return self.fault
        if self.given != self.recorded:
            return f"{list(self.given)} rows and columns, {list(self.recorded)} then"
        told = "" if self.done is None else f", done: {self.done} now"
        return f"differs by {self.difference:.3g} at {list(self.where)}{told}" if not self.is_same else "the same"


def replay_exchanges(root: Path, session: str, endpoint: str = "", timeout_s: float = 10.0) -> tuple[Answer, ...]:
    """The answers of a policy to what was shown in a session of a workspace, beside those of then.

    The recorded policy is asked where no other endpoint is given; `timeout_s` is the longest wait for one chunk [s].

    Raises:
        ExecutionError: `EVIDENCE_DAMAGED`; `POLICY_UNREACHABLE` where the first request meets no server.
        DefinitionError: The skill of the session is no policy any more.
    """
    workspace = Workspace.open(root)
    folder = workspace.evidence_of(SessionId(session))
    contract = parse_yaml(read_text(folder / CONTRACT), str(folder / CONTRACT)).data["session"]
    skills = locate_models(read_skill_registry(workspace.skill_registry), workspace.library())
    skill = skills.get(contract["skill"])
    if skill is None or skill.policy is None:
        raise DefinitionError.of("POLICY_MISMATCH", contract["skill"], "no policy", "the skill of the session")
    exchanges = read_exchanges(folder)
    start = wire.Start(session, contract["objective"], contract.get("parameters", {}), contract["seed"])
    with contextlib.closing(
        PolicyClient(endpoint or skill.policy.endpoint, timeout_s, skill.policy.observations)
    ) as client:
        return tuple(
            _ask_again(client, folder, exchange, None if index else start) for index, exchange in enumerate(exchanges)
        )


def _ask_again(client: PolicyClient, folder: Path, exchange: Exchange, start: wire.Start | None) -> Answer:
    observations, rows = read_arrays(folder, exchange)
    request = wire.Infer(
        session=folder.name,
        sequence=exchange.sequence,
        rows_done=exchange.rows_done,
        time_s=exchange.time_s,
        observations=observations,
    )
    answer = Answer(sequence=exchange.sequence, time_s=exchange.time_s, recorded=rows.shape)
    client.ask(request, start)
    try:
        while (chunk := client.poll()) is None:
            client.wait(WAIT_S)
    except ExecutionError as error:
        if error.code == "POLICY_UNREACHABLE":
            raise
        return msgspec.structs.replace(answer, fault=str(error))
    changes: dict[str, object] = {
        "given": chunk.rows.shape,
        "done": None if chunk.done is exchange.done else chunk.done,
    }
    if chunk.rows.shape == rows.shape:
        apart = np.abs(chunk.rows - rows)
        where = np.unravel_index(int(np.nan_to_num(apart, nan=np.inf).argmax()), apart.shape) if apart.size else ()
        changes |= {"difference": float(apart[where]) if apart.size else 0.0, "where": tuple(map(int, where))}
    return msgspec.structs.replace(answer, **changes)
