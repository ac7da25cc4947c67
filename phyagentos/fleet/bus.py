"""What hosts of a fleet exchange, and the port through which they do.

The hub, which serves the agent's workspace, writes an *offer* for each session that waits and opens its *claim*. A host
takes the claim by compare-and-set on the revision that the offer names: one host gets it, and none once the hub has
fenced it. Whatever happens to the session then stands in that host's journal, its *lane*, whose records travel to the
hub in order.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from enum import StrEnum
from typing import Annotated, NamedTuple, Protocol, TypeVar

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.evidence_manifest import FileName
from phyagentos.protocol.sessions.session import Session

HUB, OPERATOR = "hub", "operator"  # who is no host
PAGE = r"^(https?://[^\x00-\x20]+)?$"  # a link that a page may show
HOST_NAME = r"^(?!\.\.?$)[^/\x00-\x1f]{1,60}$"  # also that of a folder
_Struct = TypeVar("_Struct", bound=msgspec.Struct)


class Bucket(StrEnum):
    """Key-value stores of a fleet."""

    OFFERS = "offers"
    """`<target>.<session>`: what the hub wants; written by the hub alone."""
    CLAIMS = "claims"
    """`<session>`: who holds it; opened and fenced by the hub, taken and renewed by a host."""
    HOSTS = "hosts"
    """`<host>`: what it offers, renewed every second."""
    STOPS = "stops"
    """`stop`: the latest emergency stop for all."""


class EndEntry(msgspec.Struct, frozen=True):
    """One record that brings a session to its end on the host, as the agent decided it."""

    trigger: str
    body: Fields = {}


class Offer(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A session that waits for a host, or has one.

    Attributes:
        number: Of its submission; a lower one comes first among equal priorities.
        revision: Of the claim that a host may take.
        lease_s: How long a claim holds unless it is renewed [s].
        hosts: How many could take it.
        home: The one in whose world its episode has begun, while that one is alive; empty for any.
        is_cancelled: Whether an end is requested.
        end: The verdict, once there is one.
    """

    contract: Session
    number: int
    revision: int
    lease_s: float
    hosts: int = 1
    home: str = ""
    is_cancelled: bool = False
    end: tuple[EndEntry, ...] = ()

    def __post_init__(self) -> None:
        msgspec.convert(self.contract.id, FileName)  # so are files of the host called


class Claim(msgspec.Struct, frozen=True, kw_only=True):
    """Who holds a session; read it by `read_claim`.

    Attributes:
        host: Empty while no host holds it. A host's own claim need not name it: its subject does.
        epoch: 0 while it is open; one more with each claim and each fence.
        beat: Renewals so far.
        is_fenced: Whether the hub ended it: no host may take it, renew it or go on under it.
    """

    host: str = ""
    epoch: int = 0
    lease_s: float = 0.0
    beat: int = 0
    is_fenced: bool = False


class HostCard(msgspec.Struct, frozen=True, kw_only=True):
    """What a host says of itself.

    Attributes:
        host: Its name, and that of its partition of the journal: its lane.
        targets: Those that it runs, each with the skills that it can carry out.
        load: Sessions that it holds.
        beat: Grows with each renewal.
        is_stopped: Whether its emergency stop is latched.
        page: Address of the page of its workspace, for people; empty without one.
    """

    host: Annotated[str, msgspec.Meta(pattern=HOST_NAME)]
    targets: dict[str, tuple[str, ...]]
    load: int = 0
    beat: int = 0
    is_stopped: bool = False
    page: Annotated[str, msgspec.Meta(pattern=PAGE)] = ""

    def offers(self, session: Session) -> bool:
        """Whether it can carry out this skill on this target."""
        return session.skill in self.targets.get(session.target, ())


class Frame(NamedTuple):
    """One record of a lane, byte by byte as it stands in this segment."""

    segment: str
    data: bytes


class Stored(NamedTuple):
    """A value with its revision; `by` whom, as the subject of a claim says: only that one may write there."""

    value: bytes
    revision: int
    by: str


class BusLost(ExecutionError):
    """The server does not answer; what was sent may have arrived or not."""

    def __init__(self, what: str) -> None:
        super().__init__(
            "NOT_RUNNING", f"{what}. Start it with the command that `paos fleet server` prints, or look at the network."
        )


class Bus(Protocol):
    """The port. Every call may raise BusLost; none waits for longer than some seconds."""

    @property
    def is_connected(self) -> bool:
        """Whether the server answers; after a break the views are read anew before it is True again."""

    def fileno(self) -> int:
        """Readable after news, until `drain`."""

    def drain(self) -> None:
        """Forget the news so far; call it before looking."""

    def ring(self) -> None:
        """Make news; from any thread."""

    @property
    def bundles(self) -> int:
        """How many bundles have arrived at the server, as far as this has been heard; it grows."""

    def view(self, bucket: Bucket) -> Mapping[str, Stored]:
        """The values of a bucket as far as they have arrived here."""

    def on_change(self, bucket: Bucket, act: Callable[[bytes], None]) -> None:
        """Call this with each value that arrives, at once and in another thread."""

    def get(self, bucket: Bucket, key: str) -> Stored | None:
        """The value as the server has it now."""

    def put(self, bucket: Bucket, key: str, value: bytes) -> None:
        """Replace a value."""

    def swap(self, bucket: Bucket, key: str, value: bytes, revision: int) -> int | None:
        """Replace the value of this revision, 0 for none; the new one, or None where another one stands there."""

    def put_all(self, values: Mapping[tuple[Bucket, str], bytes | None]) -> None:
        """Replace several values, and forget those that are None, in the time of one."""

    def open_all(self, bucket: Bucket, values: Mapping[str, bytes]) -> dict[str, int | None]:
        """Set what is not there; the revisions, None where something is."""

    def find_end(self, lane: str) -> int:
        """Number of the last record of a lane, as far as that has arrived here."""

    def count(self, lane: str) -> int:
        """Number of the last record of a lane that the server has."""

    def append(self, lane: str, after: int, frames: Sequence[Frame]) -> None:
        """Add the records behind number `after`; each counts once, however often it is sent."""

    def read(self, lane: str, after: int, up_to: int) -> list[Frame]:
        """The records behind `after` that the server has, up to a number."""

    def read_all(self, wanted: Mapping[str, tuple[int, int]]) -> dict[str, list[Frame]]:
        """The same of several lanes, in the time of one."""

    def store(self, name: str, data: bytes) -> None:
        """Keep an object of the own lane, unless it is kept already."""

    def load(self, lane: str, name: str) -> bytes | None:
        """An object of a lane."""

    def close(self) -> None:
        """Let go of the connection."""


def read_claim(found: Stored | None) -> Claim | None:
    """A claim, None where none can be read. Only the hub fences, and names the host that it has fenced."""
    claim = find_read(found.value, Claim) if found is not None else None
    if claim is None or found is None or found.by == HUB:
        return claim
    return msgspec.structs.replace(claim, host=found.by, is_fenced=False)


def read_cards(values: Mapping[str, Stored]) -> list[HostCard]:
    """What hosts say of themselves, each under the key that it alone may write: of another one it says nothing."""
    found = {key: find_read(each.value, HostCard) for key, each in sorted(values.items())}
    return [card for key, card in found.items() if card is not None and encode_key(card.host) == key]


def find_read(value: bytes | None, of: type[_Struct]) -> _Struct | None:
    """What a hub or host wrote; None for anything else, as by one of another version: that ends no process."""
    try:
        return msgspec.json.decode(value or b"", type=of)
    except msgspec.DecodeError:
        return None


def iter_read(values: Iterable[Stored], of: type[_Struct]) -> Iterator[_Struct]:
    """The values that can be read."""
    return (found for each in values if (found := find_read(each.value, of)) is not None)


def hide_token(url: str) -> str:
    """The addresses of servers, for people and logs."""
    return ",".join(each.rpartition("@")[2] for each in url.split(","))


def encode_key(text: str) -> str:
    """A name as one token of a key: letters, digits, `_` and `-`; the rest by its number."""
    return re.sub(r"[^A-Za-z0-9_-]", lambda found: f"={ord(found[0]):x}=", text)


def decode_key(token: str) -> str:
    """The name of a token."""
    return re.sub(r"=([0-9a-f]+)=", lambda found: chr(int(found[1], 16)), token)


def get_offer_key(session: Session) -> str:
    """Key of an offer."""
    return f"{encode_key(session.target)}.{encode_key(session.id)}"
