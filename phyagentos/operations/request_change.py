"""Other limits or another priority for a session that is pending, asked for as any program may: a file in the inbox."""

import os
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path

import msgspec
import yaml

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.edits.inbox import read_request


class ChangeRequest(msgspec.Struct, frozen=True, kw_only=True):
    """The file that holds the request; SESSIONS.md shows what became of it."""

    file: Path


def request_change(
    root: Path, session: str, *, limits: Mapping[str, float] | None = None, priority: int | None = None
) -> ChangeRequest:
    """Leave a request for `limits` (`timeout_s`, `stall_s` [s]) or a `priority`; raises as `read_request` does."""
    body: Fields = {"kind": "amend", "session": session}
    body |= {"limits": dict(limits)} if limits else {}
    body |= {"priority": priority} if priority is not None else {}
    inbox, data = Workspace.open(root).inbox, yaml.safe_dump(body, sort_keys=False).encode()
    temporary = inbox / "tmp" / f"request-{sha256(data).hexdigest()[:12]}-{os.getpid()}.yaml"
    temporary.write_bytes(data)
    try:
        read_request(temporary)
    except DefinitionError:
        temporary.unlink()
        raise
    return ChangeRequest(file=temporary.replace(inbox / "new" / temporary.name))
