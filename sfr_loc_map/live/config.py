"""How the live page is served."""

from __future__ import annotations

from dataclasses import dataclass

from sfr_loc_map.config import param

DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 8080


@dataclass(frozen=True, slots=True)
class LiveConfig:
    """How the page is served."""

    host: str = param(DEFAULT_HOST, doc="Address to listen on; another than loopback needs a token.")
    port: int = param(DEFAULT_PORT, doc="Port to listen on; 0: a free one.", low=0, high=65535)
    token: str = param("", doc="Word that each request must have; needed where other hosts are let in.")
    bytes_per_s: float = param(2e6, unit="B/s", doc="Budget of images and clouds for each page.", low=1e4, high=1e9)
