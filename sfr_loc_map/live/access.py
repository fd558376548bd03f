"""Access control of the live page.

On loopback no token is required, but the host name of a request must be a loopback name, because a foreign name may
resolve to this host (DNS rebinding). On another address each request requires the token: either in the query
(`?token=`), after which a cookie keeps the token, or as `Authorization: Bearer`. Requests that originate from another
page are refused.
"""

from __future__ import annotations

import hmac
from urllib.parse import urlsplit

from aiohttp import web

from sfr_loc_map.live.config import is_loopback

TOKEN_COOKIE = "sfr_live_token"


def refusal_of(request: web.Request, token: str) -> str:
    """Return why a request is refused; empty if it has access. An empty `token` means that no token is required."""
    host = request.headers.get("Host", "")
    origin = request.headers.get("Origin")
    if not token and not is_loopback(_split(f"//{host}")[0]):
        return (
            "this page is served only for 127.0.0.1 and localhost: open it by one of these names, or start sfr live "
            "with --host and --token"
        )
    if origin is not None and _split(origin)[1] != host:
        return "the request comes from another page"
    if token and not any(is_equal(word, token) for word in _given_tokens(request)):
        return "a token is required: open the address that sfr live has printed"
    return ""


def _given_tokens(request: web.Request) -> tuple[str, str, str]:
    """Return the tokens in the query, in the cookie and in the header of a request; empty if missing."""
    scheme, _, bearer = request.headers.get("Authorization", "").partition(" ")
    bearer = bearer if scheme.lower() == "bearer" else ""
    return request.query.get("token", ""), request.cookies.get(TOKEN_COOKIE, ""), bearer


def _split(url: str) -> tuple[str, str]:
    """Return the host name of an address, without and with the port; both are empty if the address is invalid."""
    try:
        found = urlsplit(url)
        return found.hostname or "", found.netloc
    except ValueError:
        return "", ""


def is_equal(given: str, wanted: str) -> bool:
    """Compare two tokens in a time that does not depend on their content."""
    # invalid UTF-8 bytes in a header were decoded to surrogates
    return hmac.compare_digest(given.encode(errors="surrogatepass"), wanted.encode())
