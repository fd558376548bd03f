"""The known components of true attitudes: all of them, the heading alone, or none.

Unknown components of a truth are placeholders. Every use of true attitudes therefore either requires complete attitudes
(`check_true_attitudes`) or replaces the unknown components by those of the estimate (`known_attitudes`).
"""

from __future__ import annotations

import numpy as np

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import quat_multiply
from sfr_loc_map.geometry.trajectory import Trajectory, Truth, as_truth
from sfr_loc_map.metrics import formulas


def incomplete_attitudes(truth: Trajectory) -> str | None:
    """Return what a truth has instead of complete attitudes, for messages; None if its attitudes are complete."""
    if not truth.has_attitude:
        return "only positions"
    return None if as_truth(truth).has_tilt else "no roll and pitch"


def check_true_attitudes(truth: Trajectory, purpose: str, remedy: str) -> None:
    """Check that a truth has complete attitudes; MetricsError if not, with the purpose and the remedy."""
    found = incomplete_attitudes(truth)
    if found is not None:
        raise MetricsError(f"{purpose} requires true attitudes, but the truth has {found}: {remedy}")


def known_attitudes(truth: Truth, true_attitude: FloatArray, attitude: FloatArray) -> FloatArray:
    """Return true attitudes `(F, 4)` whose unknown components are those of the estimated attitudes `(F, 4)`.

    Without true roll and pitch, the true heading is combined with the roll and pitch of the estimate. The estimate is
    then re-based at N only by the difference of the headings. Without true attitudes, the estimated attitudes are
    returned. Quaternions are scalar last and have unit length.
    """
    if not truth.has_attitude:
        return attitude
    if truth.has_tilt:
        return true_attitude
    half_turn = 0.5 * (formulas.heading(true_attitude) - formulas.heading(attitude))
    zeros = np.zeros_like(half_turn)
    about_z = np.column_stack((zeros, zeros, np.sin(half_turn), np.cos(half_turn)))
    return quat_multiply(about_z, attitude)
