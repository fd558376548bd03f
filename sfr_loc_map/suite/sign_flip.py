"""Do drives agree that one run is worse than another: a sign-flip test.

Where two runs are equally good, each drive's log ratio of errors is as likely positive as negative. The mean log ratio
is compared with its distribution over all choices of signs (Fisher 1935; exact for few drives, drawn for many). No
distribution of the errors is assumed, and one bad drive decides nothing.
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray

EXACT_DRIVES = 14
DRAWS, MAX_DRAWS = 20000, 200000
ENOUGH = 10
SEED = 20260202
MIN_DRIVES = 6
"""With fewer drives no choice of signs has a probability under 0.03."""


def sign_flip_p(log_ratios: FloatArray) -> float | None:
    """Return the two-sided probability of a mean log ratio as large by chance; None with too few drives.

    Args:
        log_ratios: `(D,)` one for each drive; 0 where both are equal.
    """
    count = len(log_ratios)
    if count < MIN_DRIVES:
        return None
    if not log_ratios.any():
        return 1.0
    observed = abs(log_ratios.sum()) * (1.0 - 1e-12)
    if count <= EXACT_DRIVES:
        bits = (np.arange(2**count)[:, None] >> np.arange(count)) & 1
        sums = np.abs((2.0 * bits - 1.0) @ log_ratios)
        return float(np.mean(sums >= observed))
    rng = np.random.default_rng([SEED, count])
    exceeded = drawn = 0
    while exceeded < ENOUGH and drawn < MAX_DRAWS:  # few draws decide a large probability (Besag, Clifford 1991)
        signs = rng.integers(0, 2, (DRAWS, count), dtype=np.int8) * 2.0 - 1.0
        exceeded += int(np.count_nonzero(np.abs(signs @ log_ratios) >= observed))
        drawn += DRAWS
    return (1 + exceeded) / (1 + drawn)


def smallest_p(count: int) -> float:
    """Return the smallest probability that so many drives can show."""
    return 2.0 ** (1 - count) if count <= EXACT_DRIVES else 1.0 / (1 + MAX_DRAWS)
