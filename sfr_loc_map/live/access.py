"""Who may look on and who may command: host and origin of a request, tokens.

On loopback no token is needed to look on, but the name that the page was asked by must be one of loopback: a name of
somebody else's that resolves to this host (DNS rebinding) is refused. Served to other hosts, each request needs the
token, as `?token=` once (a cookie keeps it) or as `Authorization: Bearer`.
"""

from __future__ import annotations

import hmac
import ipaddress
from dataclasses import dataclass
from urllib.parse import urlsplit

from aiohttp import web

from sfr_loc_map.errors import ConfigError

COOKIE = "sfr_live_token"
COMMAND_HEADER = "X-SFR-Token"
MIN_TOKEN = 8
LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def is_loopback(host: str) -> bool:
    """Tell whether a host can be reached from this machine alone."""
    if host in LOOPBACK_NAMES:
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True, slots=True)
class Access:
    """The rules of one server.

    Attributes:
        host: What it listens on.
        token: Which each request from elsewhere must have; empty on loopback without one.
        command_token: Which a command must have; the page alone is told.
    """

    host: str
    token: str
    command_token: str

    def __post_init__(self) -> None:
        """Check that others need a token.

        Raises:
            ConfigError: If there is none, or a short one.
        """
        if not self.token and not is_loopback(self.host):
            raise ConfigError(f"'{self.host}' lets other hosts in: give --token, {MIN_TOKEN} letters or more")
        if self.token and (len(self.token) < MIN_TOKEN or not self.token.isascii() or not self.token.isprintable()):
            raise ConfigError(f"--token must have at least {MIN_TOKEN} printable ASCII letters")

    def refusal(self, request: web.Request) -> str:
        """Return why a request is refused, empty if it is not."""
        name = _host_name(request.headers.get("Host", ""))
        if not self.token and not is_loopback(name):
            return "this page is for 127.0.0.1 and localhost alone"
        origin = request.headers.get("Origin")
        if origin is not None and _place(origin) != request.headers.get("Host"):
            return "the request comes from another page"
        if self.token and not self._has_token(request):
            return "a token is needed: open the address that sfr live has printed"
        return ""

    def may_command(self, request: web.Request) -> bool:
        """Tell whether a request comes from the page that this server has sent."""
        return _equal(request.headers.get(COMMAND_HEADER, ""), self.command_token)

    def _has_token(self, request: web.Request) -> bool:
        scheme, _, bearer = request.headers.get("Authorization", "").partition(" ")
        given = (request.query.get("token", ""), request.cookies.get(COOKIE, ""), bearer if scheme == "Bearer" else "")
        return any(_equal(word, self.token) for word in given)


def _equal(given: str, wanted: str) -> bool:
    # Bytes of a header that are no UTF-8 come as halves of surrogate pairs.
    return hmac.compare_digest(given.encode(errors="surrogatepass"), wanted.encode())


def _place(origin: str) -> str:
    """Return host and port of an Origin header."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return ""


def _host_name(host: str) -> str:
    """Return the name in a Host header, without the port."""
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""
