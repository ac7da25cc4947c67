"""The tree of the session that runs, served to Groot2 as `Groot2Publisher` of BehaviorTree.CPP 4 serves its own.

It follows the journal and the trace, and commands nothing: breakpoints and recordings are refused.
"""

import struct
import uuid
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

import msgspec

from phyagentos.errors import DefinitionError, needs_extra
from phyagentos.operations.behaviour_trees import read_live_tree
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.sessions.evidence import TRACE
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.follower import Follower
from phyagentos.store.journal import choose_partition
from phyagentos.store.ledger import Ledger

if TYPE_CHECKING:
    from phyagentos.export.groot2_tree import LiveTree

PORT = 1667  # Groot2's own default
LOOK_MS = 200
PROTOCOL, HEAD = 2, struct.Struct("<BcI")  # protocol, kind and number of a request
TREE, STATES, BLACKBOARD, HOOKS = b"T", b"S", b"B", b"D"
NO_VALUES, NO_HOOKS = b"\x80", b"[]"  # an empty map of MessagePack; an empty list of JSON


def serve_groot2(root: Path, ends: Event, announce: Callable[[str], None], *, port: int = PORT) -> None:
    """Answer Groot2 at a port of this machine, 0 for a free one, until `ends`; the address is announced.

    Raises DefinitionError `EXTRA_MISSING`, and `INVALID_VALUE` for a port that is taken.
    """
    with needs_extra("groot2", "paos tree serve"):
        import zmq
    shown = ShownSession(root)
    with zmq.Context() as context, context.socket(zmq.REP) as replies:
        replies.linger = 0
        try:
            replies.bind(f"tcp://127.0.0.1:{port or '*'}")
        except zmq.ZMQError as error:
            raise DefinitionError.of("INVALID_VALUE", "--port", str(error), "a free port, or 0") from error
        announce(replies.get_string(zmq.LAST_ENDPOINT))
        while not ends.is_set():
            if replies.poll(LOOK_MS):
                replies.send_multipart(shown.answer(replies.recv_multipart()))


class ShownSession:
    """The session whose tree is shown: that which a worker holds, else the last one that had a tree."""

    def __init__(self, root: Path) -> None:
        self._workspace, self._ledger = Workspace.open(root), Ledger(forgets=False)
        self._follower: Follower | None = None
        self._id, self._read = SessionId(""), 0
        self._tree: LiveTree | None = None

    def answer(self, request: list[bytes]) -> list[bytes]:
        """The parts of the reply to those of a request."""
        if len(request[0]) != HEAD.size or request[0][0] != PROTOCOL:
            return [b"error", b"wrong request header"]
        self._refresh()
        if self._tree is None:
            return [b"error", b"no session with a tree has run yet"]
        contents = {TREE: self._tree.xml.encode(), STATES: self._tree.encode(), BLACKBOARD: NO_VALUES, HOOKS: NO_HOOKS}
        _, kind, _ = HEAD.unpack(request[0])
        if kind not in contents:
            return [b"error", b"this publisher shows states alone: no breakpoints, no recording"]
        return [request[0] + uuid.uuid5(uuid.NAMESPACE_URL, self._id).bytes, contents[kind]]

    def _refresh(self) -> None:
        folder = self._workspace.sessions / choose_partition(self._workspace.sessions)
        if self._follower is None and folder.is_dir():
            self._follower = Follower(folder)
        self._ledger.extend(self._follower.read_new() if self._follower is not None else ())
        held = [each for each in self._ledger.live_sessions() if each.claimed_by]
        for status in reversed(held or [*self._ledger.sessions.values()]):
            if status.contract.id == self._id or self._open(status):
                break
        path = self._workspace.evidence_of(self._id) / TRACE
        if self._tree is None or path.stat().st_size == self._read:
            return
        *lines, rest = path.read_bytes().split(b"\n")
        self._tree.follow(msgspec.json.decode(line, type=TraceEvent) for line in lines)
        self._read = sum(len(line) + 1 for line in lines) + len(rest)

    def _open(self, status: SessionStatus) -> bool:
        """Show a session from now on, if it has a tree and has begun."""
        library, id = self._workspace.library(), status.contract.id
        if not (self._workspace.evidence_of(id) / TRACE).is_file():
            return False
        try:
            tree = read_skill(library.get_skill(status.contract.skill))[0].tree
            self._id, self._tree, self._read = id, read_live_tree(tree, library), 0
        except DefinitionError:
            return False
        return True
