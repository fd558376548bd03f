"""Absolute and relative pose errors after an alignment, as the tools of the field give them.

APE and RPE are those of Sturm et al. 2012 (IROS, section IV) and of evo (github.com/MichaelGrupp/evo), whose results on
the same files are equal; ATE is another name of the APE of positions. They stand beside the figures of the
specification, which know no alignment.

Poses are paired by the nearest stamp: each pose of the trajectory that has fewer takes the nearest one of the other
(the earlier of two), if it is near enough. Both are sorted by stamp first; of several poses with one stamp the last
counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.errors import MetricsError
from sfr_loc_map.geometry.arrays import FloatArray, IntArray
from sfr_loc_map.geometry.rotation import (
    matrix_from_quat,
    quat_conjugate,
    quat_from_matrix,
    quat_multiply,
    quat_normalised,
    quat_rotate,
)
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.metrics.association import unique_rows
from sfr_loc_map.metrics.config import AlignedErrorConfig, Condition, ConditionKind
from sfr_loc_map.metrics.score import (
    AlignedError,
    AlignedErrors,
    Alignment,
    AlignmentTransform,
    ErrorStatistics,
)

Pairs = NDArray[np.intp]
UMEYAMA = {
    Alignment.SE3: "rotation and translation by Umeyama",
    Alignment.SIM3: "scale, rotation, translation by Umeyama",
}
ALIGNMENT_TEXTS = {Alignment.NONE: "not aligned", Alignment.ORIGIN: "aligned at the first pose", **UMEYAMA}


class Poses(NamedTuple):
    """Positions `(N, 3)`, m, and unit quaternions `(N, 4)`, scalar last."""

    positions: FloatArray
    quats: FloatArray


class SingleErrors(NamedTuple):
    """Errors of single poses or motions, `(N,)` each: m, deg."""

    translation_m: FloatArray
    rotation_deg: FloatArray


class AlignedPoses(NamedTuple):
    """Paired poses after the alignment.

    Attributes:
        estimate: Aligned estimate.
        truth: Truth.
        stamps_ns: Stamps of the estimate `(N,)`.
        similarity: What was applied to the estimate, None for no alignment.
    """

    estimate: Poses
    truth: Poses
    stamps_ns: IntArray
    similarity: Similarity | None


def aligned_errors(estimate: Trajectory, truth: Trajectory, config: AlignedErrorConfig) -> AlignedErrors:
    """Return absolute and relative error of an estimate.

    Args:
        estimate: Estimated poses, in any order.
        truth: True poses, in any order.
        config: Alignment, association and the length of relative errors.

    Raises:
        MetricsError: If no stamps are near enough, or the positions allow no alignment.
    """
    poses = aligned_poses(estimate, truth, config)
    delta = Condition.parse(config.rpe_delta)
    pairs = f"{len(poses.stamps_ns)} poses paired by the nearest stamp within {config.max_difference_s:g} s"
    return AlignedErrors(
        ape=_record(absolute_errors(poses), f"APE (ATE), {{0}}, {pairs}", config, poses.similarity, None),
        rpe=_record(
            relative_errors(poses, delta),
            f"RPE over {_length(delta)}, consecutive, {{0}}, {pairs}",
            config,
            poses.similarity,
            delta,
        ),
    )


def aligned_poses(estimate: Trajectory, truth: Trajectory, config: AlignedErrorConfig) -> AlignedPoses:
    """Return paired poses after the alignment.

    Raises:
        MetricsError: If no stamps are near enough, or the positions allow no alignment.
    """
    est_rows, gt_rows = unique_rows(estimate.stamps_ns), unique_rows(truth.stamps_ns)
    est_stamps, gt_stamps = estimate.stamps_ns[est_rows], truth.stamps_ns[gt_rows]
    limit = round(config.max_difference_s * NS_PER_S)
    if len(est_rows) > len(gt_rows):
        short, long = nearest_pairs(gt_stamps, est_stamps, limit)
        est_rows, gt_rows = est_rows[long], gt_rows[short]
    else:
        short, long = nearest_pairs(est_stamps, gt_stamps, limit)
        est_rows, gt_rows = est_rows[short], gt_rows[long]
    if not len(est_rows):
        raise MetricsError(
            f"no stamps of estimate and truth are within {config.max_difference_s:g} s of each other, so that there is "
            "no APE: give another --max-difference, or leave --align out"
        )
    est = Poses(estimate.positions[est_rows], quat_normalised(estimate.quats_xyzw[est_rows]))
    true = Poses(truth.positions[gt_rows], quat_normalised(truth.quats_xyzw[gt_rows]))
    similarity = _alignment(est, true, Alignment(config.align))
    if similarity is not None:
        turned = quat_multiply(quat_from_matrix(similarity.rotation), est.quats)
        est = Poses(similarity.apply(est.positions), turned)
    return AlignedPoses(est, true, estimate.stamps_ns[est_rows], similarity)


def nearest_pairs(stamps: IntArray, others: IntArray, limit: int) -> tuple[Pairs, Pairs]:
    """Return indices of stamps and of the nearest others, the earlier of two, where they are within the limit, ns.

    Both are in order; one of the others may belong to several stamps.
    """
    if not len(stamps) or not len(others):
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    after = np.minimum(np.searchsorted(others, stamps), len(others) - 1)
    before = np.maximum(after - 1, 0)
    later = np.abs(others[after] - stamps) < np.abs(stamps - others[before])
    nearest = np.where(later, after, before)
    chosen = np.flatnonzero(np.abs(others[nearest] - stamps) <= limit)
    return chosen, nearest[chosen]


def _alignment(estimate: Poses, truth: Poses, alignment: Alignment) -> Similarity | None:
    if alignment is Alignment.NONE:
        return None
    if alignment is Alignment.ORIGIN:
        turn = quat_multiply(truth.quats[0], quat_conjugate(estimate.quats[0]))
        translation = truth.positions[0] - quat_rotate(turn, estimate.positions[0])
        return Similarity(1.0, matrix_from_quat(turn), translation)
    return umeyama(estimate.positions, truth.positions, with_scale=alignment is Alignment.SIM3)


def absolute_errors(poses: AlignedPoses) -> SingleErrors:
    """Return the errors of each pose: distance of the positions, angle between the attitudes."""
    est, true = poses.estimate, poses.truth
    distances = np.linalg.norm(est.positions - true.positions, axis=1)
    return SingleErrors(distances, _angles_deg(quat_multiply(quat_conjugate(true.quats), est.quats)))


def relative_errors(poses: AlignedPoses, delta: Condition) -> SingleErrors:
    """Return the errors of consecutive motions: `E = inv(inv(Q_i) Q_j) inv(P_i) P_j`, Q the truth, P the estimate.

    Args:
        poses: Paired poses.
        delta: Frames or metres of the estimate from i to j; the next motion begins at j.

    Raises:
        MetricsError: If it is a time.
    """
    ends = _ends(poses.estimate.positions, delta)
    i, j = ends[:-1], ends[1:]
    (true_move, true_turn), (est_move, est_turn) = (_motion(each, i, j) for each in (poses.truth, poses.estimate))
    distances = np.linalg.norm(est_move - true_move, axis=1)
    return SingleErrors(distances, _angles_deg(quat_multiply(quat_conjugate(true_turn), est_turn)))


def _length(delta: Condition) -> str:
    """Return the length of a relative error in words."""
    if delta.kind is ConditionKind.FRAMES:
        return "each frame" if delta.value == 1 else delta.label
    return f"{delta.label} of the estimate's path"


def _motion(poses: Poses, i: Pairs, j: Pairs) -> Poses:
    """Return the motions `inv(T_i) T_j`."""
    back = quat_conjugate(poses.quats[i])
    return Poses(quat_rotate(back, poses.positions[j] - poses.positions[i]), quat_multiply(back, poses.quats[j]))


def _ends(positions: FloatArray, delta: Condition) -> Pairs:
    """Return the poses at which motions begin and end."""
    if delta.kind is ConditionKind.FRAMES:
        return np.arange(0, len(positions), int(delta.value), dtype=np.intp)
    if delta.kind is ConditionKind.TIME:
        raise MetricsError(f"a relative error over {delta} is not defined: give frames=NUMBER or distance=METRES")
    ends, travelled = [0], 0.0
    for index, step in enumerate(np.linalg.norm(np.diff(positions, axis=0), axis=1).tolist(), 1):
        travelled += step
        if travelled >= delta.value:
            ends.append(index)
            travelled = 0.0
    return np.array(ends, np.intp)


def _angles_deg(quats: FloatArray) -> FloatArray:
    """Return the angles of rotations `(N, 4)`: `2 atan2(|v|, |w|)`, deg."""
    return np.asarray(np.degrees(2.0 * np.arctan2(np.linalg.norm(quats[:, :3], axis=1), np.abs(quats[:, 3]))))


def _record(
    errors: SingleErrors,
    description: str,
    config: AlignedErrorConfig,
    similarity: Similarity | None,
    delta: Condition | None,
) -> AlignedError:
    alignment = Alignment(config.align)
    text = ALIGNMENT_TEXTS[alignment]
    if alignment in UMEYAMA:
        text = f"{alignment} aligned ({text})"
    transform = None
    if similarity is not None:
        quat = quat_from_matrix(similarity.rotation)
        place = tuple(similarity.translation.tolist())
        transform = AlignmentTransform(scale=similarity.scale, quat_xyzw=tuple(quat.tolist()), translation_m=place)
    return AlignedError(
        description=description.format(text),
        alignment=alignment,
        association="nearest stamp",
        max_difference_s=config.max_difference_s,
        delta=delta,
        count=len(errors.translation_m),
        unit="m",
        translation=_statistics(errors.translation_m),
        rotation_deg=_statistics(errors.rotation_deg),
        transform=transform,
    )


def _statistics(errors: FloatArray) -> ErrorStatistics:
    if not len(errors):
        return ErrorStatistics(rmse=None, mean=None, median=None, std=None, min=None, max=None)
    return ErrorStatistics(
        rmse=float(np.sqrt(np.mean(np.square(errors)))),
        mean=float(np.mean(errors)),
        median=float(np.median(errors)),
        std=float(np.std(errors)),
        min=float(np.min(errors)),
        max=float(np.max(errors)),
    )


class Similarity(NamedTuple):
    """`p -> scale R p + t`."""

    scale: float
    rotation: FloatArray
    translation: FloatArray

    def apply(self, points: FloatArray) -> FloatArray:
        """Take points `(N, 3)` along."""
        return np.asarray((self.scale * points) @ self.rotation.T + self.translation)


def umeyama(points: FloatArray, targets: FloatArray, *, with_scale: bool) -> Similarity:
    """Return the similarity that takes points nearest to their targets: `min sum |target - (s R p + t)|^2`.

    Args:
        points: `(N, 3)`, metres.
        targets: `(N, 3)`, metres.
        with_scale: Whether the scale is estimated; otherwise it is 1.

    Raises:
        MetricsError: If the points lie on a line or in one place, so that no rotation follows from them.
    """
    mean_p, mean_t = points.mean(axis=0), targets.mean(axis=0)
    p, t = points - mean_p, targets - mean_t
    covariance = t.T @ p / len(points)  # equation 38
    u, singular, vt = np.linalg.svd(covariance)
    if np.count_nonzero(singular > np.finfo(np.float64).eps) < 2:
        raise MetricsError(
            f"{len(points)} positions on a line or in one place have no alignment by least squares: use --align origin"
        )
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt)) or 1.0])  # equation 43
    rotation = (u * signs) @ vt  # equation 40
    scale = float((singular * signs).sum() / np.square(p).sum(axis=1).mean()) if with_scale else 1.0  # equation 42
    return Similarity(scale, rotation, mean_t - scale * (rotation @ mean_p))  # equation 41


MOST_POINTS = 5000
"""Poses of a path that are drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One path.

    Attributes:
        name: Its name.
        seconds: `(N,)` since the first stamp of all.
        positions: `(N, 3)`, m.
        error_m: `(N,)` distance to the truth, None of the truth and without one.
        is_truth: Whether it is the truth.
    """

    name: str
    seconds: FloatArray
    positions: FloatArray
    error_m: FloatArray | None = None
    is_truth: bool = False


def curves_of(
    trajectories: Mapping[str, Trajectory], truth: Trajectory | None, config: AlignedErrorConfig
) -> list[Curve]:
    """Return trajectories as curves; with a truth it comes first, and each is aligned with it.

    Raises:
        MetricsError: If one has no pose, or no stamps near those of the truth.
    """
    given = [poses for poses in (*trajectories.values(), truth) if poses is not None and len(poses)]
    if len(given) < len(trajectories) + (truth is not None) or not given:
        raise MetricsError("a trajectory without poses cannot be drawn: leave it out")
    begin = min(int(poses.stamps_ns.min()) for poses in given)
    if truth is None:
        return [_curve(name, poses.stamps_ns, poses.positions, begin) for name, poses in trajectories.items()]
    curves = [_curve("truth", truth.stamps_ns, truth.positions, begin, is_truth=True)]
    for name, poses in trajectories.items():
        paired = aligned_poses(poses, truth, config)
        error_m = absolute_errors(paired).translation_m
        curves.append(_curve(name, paired.stamps_ns, paired.estimate.positions, begin, error_m))
    return curves


def _curve(
    name: str,
    stamps_ns: IntArray,
    positions: FloatArray,
    begin_ns: int,
    error_m: FloatArray | None = None,
    *,
    is_truth: bool = False,
) -> Curve:
    every = slice(None, None, max(1, -(-len(stamps_ns) // MOST_POINTS)))
    seconds = ((stamps_ns[every] - begin_ns) / NS_PER_S).astype(np.float64)
    return Curve(name, seconds, positions[every], None if error_m is None else error_m[every], is_truth)
