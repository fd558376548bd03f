"""A drift of the right camera is followed; noise and single shifts are none."""

import numpy as np
import pytest

from sfr_loc_map.localisation.backend.right_drift import AFTERMATH_PAIRS, RightDrift
from sfr_loc_map.localisation.frontend.right_shift import RightShift


def follow(true_px: np.ndarray, noise_px: float, seed: int = 0) -> tuple[np.ndarray, RightDrift]:
    """Return the corrections so far after each pair, of landmarks that are never replaced."""
    drift, random = RightDrift(), np.random.default_rng(seed)
    corrected = [0.0]
    for px in true_px:
        corrected.append(corrected[-1] + drift.learn(RightShift(px - corrected[-1] + random.normal(0, noise_px), 1e-4)))
    return np.array(corrected[1:]), drift


@pytest.mark.parametrize(("rate", "noise"), [(0.02, 0.004), (-0.02, 0.004), (0.005, 0.004), (0.02, 0.02)])
def test_steady_drift_is_followed_to_some_hundredths_of_a_pixel(rate: float, noise: float) -> None:
    true = rate * np.arange(120)
    corrected, drift = follow(true, noise)
    assert drift.active
    assert np.abs(corrected - true)[20:].max() < 0.03 + 5 * noise
    assert abs((corrected - true)[20:].mean()) < 0.02 + noise


@pytest.mark.parametrize("noise", [0.004, 0.04, 0.1])
def test_noise_of_any_size_is_no_drift(noise: float) -> None:
    drifts = [follow(np.zeros(60), noise, seed) for seed in range(10)]
    assert sum(drift.active for _, drift in drifts) <= 1
    assert max(np.abs(corrected).max() for corrected, _ in drifts) < 2.5 * noise


def test_what_is_over_ends_and_what_belongs_to_other_landmarks_is_forgotten() -> None:
    drift = RightDrift()
    for k in range(20):
        drift.learn(RightShift(0.02 * k, 1e-4))
    assert drift.active
    drift.interrupt()
    assert all(drift.learn(RightShift(0.0, 1e-4)) == 0.0 for _ in range(AFTERMATH_PAIRS))
    assert not drift.active
    assert RightDrift().learn(RightShift(5.0, np.inf)) == 0.0
