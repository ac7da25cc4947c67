"""Streams and subjects of a fleet, and who may use which: each writes under subjects of its own.

A rollup or a change of a stream could undo what others wrote: only the hub may ask for one, but for its own evidence.
"""

from phyagentos.fleet.bus import HUB, OPERATOR, Bucket, encode_key

LANE = "paos.lane."
NEWS = "paos.news."  # then the subject of what a stream has taken; the server alone writes here
_READ = ("STREAM.INFO", "STREAM.MSG.GET", "DIRECT.GET")


def locate(bucket: Bucket) -> str:
    """What the subjects of a store begin with."""
    return f"$KV.paos_{bucket}."


def locate_claim(session: str, writer: str) -> str:
    """Where a writer keeps its claim of a session, both as tokens; `*` for all."""
    return f"{locate(Bucket.CLAIMS)}{session}.{writer}"


def name_store(bucket: Bucket) -> str:
    """The stream of a store."""
    return f"KV_paos_{bucket}"


def name_lane(lane: str) -> str:
    """The stream of a lane."""
    return f"paos_lane_{encode_key(lane)}"


def name_evidence(token: str) -> str:
    """The object store of a lane."""
    return f"paos_evidence_{token}"


def name_inbox(role: str) -> str:
    """What answers to this one come to: another one's are not heard."""
    return f"_INBOX_{encode_key(role)}"


def list_rights(role: str) -> dict[str, dict[str, list[str]]]:
    """What a server lets the hub, the operator or the host of this name publish and hear, as its configuration says."""
    if role == HUB:
        return {"publish": {"allow": [">"]}, "subscribe": {"allow": [">"]}}
    token = encode_key(role)
    heard = [*Bucket] if role == OPERATOR else [Bucket.OFFERS, Bucket.STOPS]
    objects = name_evidence(token)
    own = [f"{LANE}{token}", f"{locate(Bucket.HOSTS)}{token}", locate_claim("*", token), f"$O.{objects}.>"]
    streams = [*map(name_store, Bucket), *([name_lane(role), f"OBJ_{objects}"] if role != OPERATOR else ["*"])]
    asked = [f"$JS.API.{verb}.{stream}" for verb in _READ for stream in streams]
    written = [f"{locate(Bucket.STOPS)}stop"] if role == OPERATOR else own
    news = [f"{NEWS}{locate(bucket)}>" for bucket in heard]
    return {"publish": {"allow": [*written, *asked]}, "subscribe": {"allow": [*news, f"{name_inbox(role)}.>"]}}
