"""The configuration of the live page: address, port and token. This module does not import the web server."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass

from sfr_loc_map.configuration.parameters import param
from sfr_loc_map.errors import ConfigError

DEFAULT_HOST = "127.0.0.1"
DEFAULT_PORT = 8080
MIN_TOKEN_LETTERS = 8


@dataclass(frozen=True, slots=True)
class LiveConfig:
    """Configuration of the server."""

    host: str = param(DEFAULT_HOST, doc="Address to listen on; addresses other than loopback require a token.")
    port: int = param(DEFAULT_PORT, doc="Port to listen on; 0: any free port.", low=0, high=65535)
    token: str = param("", doc="Token that each request must contain; required if other hosts have access.")

    def __post_init__(self) -> None:
        """Raise a ConfigError if a required token is missing, or if the token is too short."""
        token = self.token
        if not token and not is_loopback(self.host):
            raise ConfigError(
                f"other hosts can open the page at '{self.host}': give --token with at least {MIN_TOKEN_LETTERS} "
                "characters"
            )
        if token and (len(token) < MIN_TOKEN_LETTERS or not token.isascii() or not token.isprintable()):
            raise ConfigError(
                f"--token is invalid: at least {MIN_TOKEN_LETTERS} printable ASCII characters are required"
            )


def is_loopback(host: str) -> bool:
    """Return whether a host name or address always denotes this host (loopback)."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
