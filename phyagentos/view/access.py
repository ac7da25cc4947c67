"""Who may see a page, and act on it: a token, the page's own origin, and a secret in every form."""

import hashlib
import hmac
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field

COOKIE, FORM_SECRET, FORM_HEADER = "paos_view", "secret", "x-paos-secret"


@dataclass(frozen=True, slots=True)
class Access:
    """The rules of one server; `hosts` are the names under which it may be asked, with their port."""

    hosts: frozenset[str]
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))

    @property
    def form_secret(self) -> str:
        """What a form of our own page carries; the token cannot be derived from it."""
        return hmac.new(self.token.encode(), b"form", hashlib.sha256).hexdigest()

    def admits(self, headers: Mapping[str, str], cookies: Mapping[str, str]) -> bool:
        """Whether a request names this server, and carries the token in its cookie, or as a bearer."""
        if headers.get("host", "") not in self.hosts:  # another name that leads here: DNS rebinding
            return False
        scheme, _, given = headers.get("authorization", "").partition(" ")
        return self.is_token(given if scheme.lower() == "bearer" else cookies.get(COOKIE, ""))

    def is_token(self, given: str) -> bool:
        """Whether this is the token."""
        return hmac.compare_digest(given.encode(), self.token.encode())

    def permits_action(self, headers: Mapping[str, str]) -> bool:
        """Whether a request comes from our own page: its origin, and the secret of its forms."""
        given = headers.get(FORM_HEADER, "").encode()
        return self.is_own_origin(headers) and hmac.compare_digest(given, self.form_secret.encode())

    def is_own_origin(self, headers: Mapping[str, str]) -> bool:
        """Whether a page of this server asks."""
        return headers.get("origin", "").partition("://")[2] in self.hosts
