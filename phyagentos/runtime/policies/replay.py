"""Shows a policy again what one was shown in a session, and compares the chunks."""

from pathlib import Path

import msgspec
import numpy as np
from typing_extensions import override

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.protocol.capabilities.registries import locate_models, read_skill_registry
from phyagentos.protocol.documents.schema import parse_yaml, read_text
from phyagentos.protocol.sessions.evidence import CONTRACT
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.client import PolicyClient
from phyagentos.runtime.policies.exchanges import Exchange, read_arrays, read_exchanges

WAIT_S = 0.5
SAME = 1e-9  # of a number of a row: more is another answer


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """One chunk beside the recorded one.

    Attributes:
        time_s: Of the observations, in the target's time [s].
        recorded: Shape of the recorded rows.
        given: Shape of the rows now; empty where there was no chunk.
        difference: Greatest of any number, in the policy's own units; infinite where the shapes differ.
        where: Row and column of it.
        done: Whether the policy says now that it is done, where it said the other thing then; None otherwise.
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
    """The answers of a policy to what was shown in a session, beside those of then.

    Args:
        root: Of the workspace.
        session: Its id.
        endpoint: Of the policy that is asked; the recorded one without it.
        timeout_s: Longest wait for one chunk [s].

    Raises:
        ExecutionError: `EVIDENCE_UNREADABLE`; `POLICY_UNREACHABLE` where the first request meets no server.
        DefinitionError: The skill of the session is no policy any more.
    """
    workspace = Workspace.open(root)
    folder = workspace.evidence_of(SessionId(session))
    contract = parse_yaml(read_text(folder / CONTRACT), str(folder / CONTRACT)).data["session"]
    skills = locate_models(read_skill_registry(workspace.skill_registry), workspace.library())
    skill = skills.get(contract["skill"])
    if skill is None or skill.policy is None:
        raise DefinitionError.of("POLICY_UNDECLARED", contract["skill"], "no policy", "the skill of the session")
    exchanges = read_exchanges(folder)
    start = wire.Start(session, contract["objective"], contract.get("parameters", {}), contract["seed"])
    client = PolicyClient(endpoint or skill.policy.endpoint, timeout_s, skill.policy.observations)
    try:
        answers = []
        for index, exchange in enumerate(exchanges):
            answers.append(_ask_again(client, folder, exchange, None if index else start))
        return tuple(answers)
    finally:
        client.close()


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
