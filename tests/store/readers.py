"""What each of the two readers says about a journal."""

import hashlib
import re

from phyagentos.errors import ExecutionError
from phyagentos.store.follower import Follower


class HashingFollower(Follower):
    """Hashes every record it accepts, header and payload, as docs/journal.md defines it."""

    def __init__(self, folder):
        super().__init__(folder)
        self.records, self._hash = 0, hashlib.sha256()

    @property
    def records_sha256(self):
        return self._hash.hexdigest()

    def accept(self, data, records):
        super().accept(data, records)
        self._hash.update(data)
        self.records += len(records)


def read_with_python(root):
    """Of the one lane of a workspace."""
    (lane,) = (path for path in (root / "sessions").iterdir() if path.name != "archive")
    follower = HashingFollower(lane)
    found = {}
    try:
        follower.read_new()
        found["tail"] = str(follower.tail)
    except ExecutionError as error:
        place = re.search(r"([\d.-]+)\.md, offset (\d+):", str(error))
        found |= {"tail": "damaged", "segment": place[1], "offset": int(place[2])}
    finally:
        follower.close()
    return found | {"records": follower.records, "seq": follower.seq, "sha256": follower.records_sha256}


def flatten(answer):
    """What the second reader answers, in the form of the first."""
    damage = answer.get("damage", {})
    return {name: value for name, value in (answer | damage).items() if name not in {"damage", "reason", "workspace"}}
