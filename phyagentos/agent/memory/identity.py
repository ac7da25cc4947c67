"""Names of entries: the same experience has the same name in every workspace and after every rebuild."""

import hashlib
import re
from collections.abc import Mapping

import msgspec

from phyagentos.protocol.sessions.memory_entries import Scope

_NO_WORD = re.compile(r"[^a-z0-9]+")
_ENCODER = msgspec.json.Encoder(order="deterministic")


def compute_id(kind: str, scope: Scope, cause: str, strategy: Mapping[str, object]) -> str:
    """Id of an entry: words for people, and a hash of all that makes it this one (`lesson-soap-grasp-lost-1f0c2a`)."""
    digest = hashlib.blake2b(_ENCODER.encode([kind, scope, cause, dict(strategy)]), digest_size=4).hexdigest()
    words = " ".join(filter(None, (kind, scope.object, scope.destination, cause))).lower()
    return f"{_NO_WORD.sub('-', words).strip('-')}-{digest}"
