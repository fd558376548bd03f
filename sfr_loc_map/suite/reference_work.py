"""A fixed work whose time stands for the speed of the host: times of other days are compared as multiples of it."""

from __future__ import annotations

import time

import cv2
import numpy as np

REFERENCE = "reference_s"
"""Name of its time among the facts of the host in a score."""
PASSES = 9


def reference_seconds() -> float:
    """Return the median time of the work, seconds: filters of an image and a solution of linear equations."""
    rng = np.random.default_rng(1)
    image = rng.integers(0, 255, (480, 640), np.uint8)
    matrix, vector = rng.normal(size=(160, 160)) + 160.0 * np.eye(160), rng.normal(size=160)
    columns, rows = np.meshgrid(np.arange(640.0, dtype=np.float32), np.arange(480.0, dtype=np.float32))
    times = []
    for _ in range(PASSES):
        begin = time.perf_counter()
        blurred = cv2.GaussianBlur(image, (9, 9), 2.0)
        cv2.remap(blurred, columns, rows, cv2.INTER_LINEAR)
        for _ in range(20):
            np.linalg.solve(matrix, vector)
        times.append(time.perf_counter() - begin)
    return float(np.median(times))
