"""An independent implementation of the trajectory figures: loops and SciPy rotations after the specification."""

import itertools
import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

Poses = tuple[Any, Any, Any]


def frames_of(estimate: Poses, truth: Poses) -> Any:
    """Poses `(stamp, truth, estimate)` of equal stamps in time order; of several poses with one stamp the last."""
    est = {int(s): (p, q) for s, p, q in zip(*estimate, strict=True)}
    gt = {int(s): (p, q) for s, p, q in zip(*truth, strict=True)}
    return [(s, gt[s], est[s]) for s in sorted(gt) if s in est]


def pairs_of(frames: list[Any], kind: str, value: float, spacing: int) -> Any:
    """Index pairs (start, end) of the sub-trajectories."""
    steps = [0.0]
    for (_, (a, _), _), (_, (b, _), _) in itertools.pairwise(frames):
        steps.append(math.dist(a, b))
    found = []
    for start in range(0, len(frames), spacing):
        travelled = 0.0
        for end in range(start + 1, len(frames)):
            travelled += steps[end]
            if kind == "distance":
                met = travelled >= value - 1e-9
            elif kind == "time":
                met = frames[end][0] - frames[start][0] >= round(value * 1e9)
            else:
                met = end - start >= value
            if met:
                found.append((start, end))
                break
    return found


def heading(rotation: Rotation) -> Any:
    x_axis = rotation.apply([1.0, 0.0, 0.0])
    return math.degrees(math.atan2(x_axis[1], x_axis[0]))


def wrapped(angle: float) -> Any:
    while angle > 180.0:
        angle -= 360.0
    while angle <= -180.0:
        angle += 360.0
    return angle


def matrix(pose: Any) -> Any:
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(pose[1]).as_matrix()
    out[:3, 3] = pose[0]
    return out


def errors_of(frames: list[Any], pairs: list[tuple[int, int]], rebase: str) -> Any:
    """Position vectors, attitude and heading errors."""
    position, attitude, headings = [], [], []
    for start, end in pairs:
        gt_n, est_n = matrix(frames[start][1]), matrix(frames[start][2])
        gt_x, est_x = matrix(frames[end][1]), matrix(frames[end][2])
        if rebase == "displacement":
            position.append((est_x[:3, 3] - est_n[:3, 3]) - (gt_x[:3, 3] - gt_n[:3, 3]))
            change, true_change = np.linalg.inv(est_n) @ est_x, np.linalg.inv(gt_n) @ gt_x
            angle = Rotation.from_matrix(true_change[:3, :3]).inv() * Rotation.from_matrix(change[:3, :3])
            attitude.append(math.degrees(angle.magnitude()))
            turns = [heading(Rotation.from_matrix(pose[:3, :3])) for pose in (est_x, est_n, gt_x, gt_n)]
            headings.append(wrapped((turns[0] - turns[1]) - (turns[2] - turns[3])))
            continue
        if rebase == "pose":
            moved = gt_n @ np.linalg.inv(est_n) @ est_x
            position.append(moved[:3, 3] - gt_x[:3, 3])
        else:
            moved = est_x
            position.append((est_x[:3, 3] - est_n[:3, 3]) - (gt_x[:3, 3] - gt_n[:3, 3]))
        is_, was = Rotation.from_matrix(moved[:3, :3]), Rotation.from_matrix(gt_x[:3, :3])
        attitude.append(math.degrees((is_ * was.inv()).magnitude()))
        headings.append(wrapped(heading(is_) - heading(was)))
    return np.array(position).reshape(-1, 3), np.array(attitude), np.array(headings)


def statistics(values: Any) -> Any:
    """Mean and sample standard deviation, NaN where undefined."""
    count = len(values)
    mean = sum(values) / count if count else math.nan
    sigma = math.sqrt(sum((v - mean) ** 2 for v in values) / (count - 1)) if count > 1 else math.nan
    return mean, sigma


def score(estimate: Poses, truth: Poses, kind: str, value: float, spacing: int, rebase: str) -> Any:
    """Figures by name; NaN where undefined."""
    frames = frames_of(estimate, truth)
    position, attitude, headings = errors_of(frames, pairs_of(frames, kind, value, spacing), rebase)
    axes = [statistics(position[:, k]) for k in range(3)]
    result = {"count": len(position), "matched": len(frames)}
    mean = math.sqrt(sum(m * m for m, _ in axes))
    sigma = math.sqrt(sum(s * s for _, s in axes))
    result["position"] = (mean, sigma, mean + 3 * sigma)
    for name, values in (("attitude", attitude), ("heading", headings)):
        mean, sigma = statistics(values)
        result[name] = (mean, sigma, abs(mean) + 3 * sigma)
    return result
