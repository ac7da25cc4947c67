"""Who may see a page, and act on it: an address and a cookie that only open together, and a secret in every form.

Browsers send the cookie of one server to every other port of the same host, so another local server may learn it: it
opens nothing without the key in the page's addresses. Everything is derived from the token by a keyed hash.
"""

import hashlib
import hmac
import secrets
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import quote

FORM_SECRET, FORM_HEADER = "secret", "x-paos-secret"


@dataclass(frozen=True, slots=True)
class Access:
    """The rules of one server.

    Attributes:
        hosts: Names under which the page may be asked for, with their port.
        scene_hosts: The same of its 3D scenes, whose port is another one; none are shown without.
        place: What the names of scenes begin with where a server shows several workspaces.
    """

    hosts: frozenset[str]
    scene_hosts: frozenset[str] = frozenset()
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))
    place: str = ""

    @property
    def cookie(self) -> str:
        """Name of the cookie, with the port: cookies of two servers of one host stand side by side."""
        return f"paos_view_{min(self.hosts, default='').rpartition(':')[2]}"

    @property
    def cookie_secret(self) -> str:
        """Value of the cookie."""
        return self._derive("cookie")

    @property
    def page_key(self) -> str:
        """First part of the path of every address of the page."""
        return self._derive("page")[:32]

    @property
    def form_secret(self) -> str:
        """What a form of our own page carries; the token cannot be derived from it."""
        return self._derive("form")

    def scene_key(self, scene: str) -> str:
        """What the address of the 3D scene of one session carries, by the name of that scene; it opens nothing else."""
        return self._derive(f"scene {scene}")[:32]

    def scene_address(self, session: str) -> str:
        """Of the 3D scene of a session; empty where none are shown."""
        host, scene = min(self.scene_hosts, default=""), f"{self.place}{session}"
        return f"http://{host}/scene/{quote(scene, safe='')}/{self.scene_key(scene)}/" if host else ""

    def admits(self, headers: Mapping[str, str], cookies: Mapping[str, str], key: str) -> bool:
        """Whether a request names this server, and carries the token as a bearer, or the cookie and the page's key."""
        if headers.get("host", "") not in self.hosts:  # another name that leads here: DNS rebinding
            return False
        scheme, _, given = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            return self.is_token(given)
        return _is_same(key, self.page_key) and _is_same(cookies.get(self.cookie, ""), self.cookie_secret)

    def admits_scene(self, headers: Mapping[str, str], scene: str, key: str) -> bool:
        """Whether a request names this server, and carries the key of a scene."""
        return headers.get("host", "") in self.scene_hosts and _is_same(key, self.scene_key(scene))

    def is_token(self, given: str) -> bool:
        """Whether this is the token."""
        return _is_same(given, self.token)

    def permits_action(self, headers: Mapping[str, str]) -> bool:
        """Whether a request comes from our own page: its origin, and the secret of its forms."""
        return self.is_own_origin(headers) and _is_same(headers.get(FORM_HEADER, ""), self.form_secret)

    def is_own_origin(self, headers: Mapping[str, str]) -> bool:
        """Whether a page of this server asks."""
        return headers.get("origin", "").partition("://")[2] in self.hosts

    def is_scene_origin(self, headers: Mapping[str, str]) -> bool:
        """Whether the frame of a scene asks."""
        return headers.get("origin", "").partition("://")[2] in self.scene_hosts

    def _derive(self, purpose: str) -> str:
        return hmac.new(self.token.encode(), purpose.encode(errors="replace"), hashlib.sha256).hexdigest()


def hash_source(text: str) -> str:
    """What a Content-Security-Policy calls one inline script or style."""
    return f"'sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _is_same(given: str, wanted: str) -> bool:
    return hmac.compare_digest(given.encode(errors="replace"), wanted.encode())
