"""What a server of a fleet reads: one file of settings for all servers, users with least rights, and their passwords.

Without settings it is one server that demands a token, whose holders may write everything.
"""

import secrets
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import msgspec

from phyagentos.errors import DefinitionError
from phyagentos.fleet.bus import HUB, OPERATOR
from phyagentos.fleet.subjects import list_rights
from phyagentos.protocol.documents.durable_files import replace_durably
from phyagentos.protocol.documents.schema import Authored

ALL = "all"  # holders of one token
_ROUTE = "route"  # by which servers of a cluster know each other


class Encryption(Authored):
    """Files in PEM; `ca` signed the certificate, and clients trust it by `SSL_CERT_FILE`."""

    certificate: Path
    key: Path
    ca: Path


class Member(Authored):
    """One server: where clients reach it, and where the other servers of a cluster do."""

    listen: str
    cluster: str = ""


class FleetSettings(Authored):
    """The file that `paos fleet server --settings` reads, the same for each server.

    Attributes:
        servers: By name; three of them are a cluster, which goes on without one of them.
        hosts: Those that may join, each of which gets a user of its own.
    """

    servers: Mapping[str, Member]
    hosts: tuple[str, ...] = ()
    tls: Encryption | None = None


class Access(NamedTuple):
    """The configuration of one server, and the URL for each user."""

    config: Mapping[str, object]
    urls: Mapping[str, str]


def open_secrets(path: Path, names: Iterable[str]) -> dict[str, str]:
    """A password for each name, kept in this file for the next start, which only its owner reads."""
    path.touch(mode=0o600)
    kept = msgspec.json.decode(path.read_bytes() or b"{}", type=dict[str, str])
    found = kept | {name: secrets.token_urlsafe(24) for name in names if name not in kept}
    if found != kept:
        replace_durably(path, msgspec.json.format(msgspec.json.encode(found)))
        path.chmod(0o600)
    return found


def configure_alone(store: Path, listen: str) -> Access:
    """One server, one token."""
    token = open_secrets(store / "secrets", ["token"])["token"]
    return Access(
        _describe("paos", listen, store) | {"authorization": {"token": token}}, {ALL: f"nats://{token}@{listen}"}
    )


def configure(settings: FleetSettings, file: Path, member: str, store: Path) -> Access:
    """The server of this name; raises DefinitionError `UNKNOWN_NAME`. Passwords stand beside the settings."""
    own = settings.servers.get(member)
    if own is None:
        raise DefinitionError.unknown("server", "--member", member, settings.servers)
    roles = (HUB, OPERATOR, *settings.hosts)
    words = open_secrets(file.with_suffix(".secrets"), (*roles, _ROUTE))
    users = [{"user": each, "password": words[each], "permissions": list_rights(each)} for each in roles]
    tls, scheme = _describe_tls(settings.tls, file.parent), "nats" if settings.tls is None else "tls"
    config = _describe(member, own.listen, store) | tls | {"authorization": {"users": users}}
    if own.cluster:
        others = [each.cluster for name, each in settings.servers.items() if name != member]
        routes = [f"nats-route://{_ROUTE}:{words[_ROUTE]}@{each}" for each in others]
        cluster = {"name": "paos", "listen": own.cluster, "routes": routes, "no_advertise": True}  # clients have URLs
        config["cluster"] = cluster | tls | {"authorization": {"user": _ROUTE, "password": words[_ROUTE]}}
    urls = {
        role: ",".join(f"{scheme}://{role}:{words[role]}@{each.listen}" for each in settings.servers.values())
        for role in roles
    }
    return Access(config, urls)


def _describe(name: str, listen: str, store: Path) -> dict[str, object]:
    jetstream = {"store_dir": str(store), "sync_interval": "always"}
    return {"server_name": name, "listen": listen, "jetstream": jetstream}


def _describe_tls(tls: Encryption | None, folder: Path) -> dict[str, object]:
    if tls is None:
        return {}
    files = {"cert_file": tls.certificate, "key_file": tls.key, "ca_file": tls.ca}
    return {"tls": {name: str(folder / each) for name, each in files.items()}}
