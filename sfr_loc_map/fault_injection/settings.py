"""Settings of the campaign."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CampaignSettings:
    """Settings of the campaign.

    Attributes:
        stop_s: How long a process is stopped by SIGSTOP, seconds.
        restart_limit_s: From the start of a killed node to its first result, seconds.
        soak_minutes: Length of the soak; 0 leaves it out.
        slope_limit: Largest growth of memory in the soak, MB/h.
        patience_s: How long a result is awaited at most, seconds.
    """

    stop_s: float = 10.0
    restart_limit_s: float = 3.0
    soak_minutes: float = 1.0
    slope_limit: float = 1.0
    patience_s: float = 30.0
