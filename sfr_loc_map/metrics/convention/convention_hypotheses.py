"""The convention mismatches that are looked into, each undone, and what disagreement is left then."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.pose_convention import MIRROR, PoseConvention
from sfr_loc_map.geometry.pose_convention import OPTICAL_IN_BODY as OPTICAL_IN_RB
from sfr_loc_map.geometry.rotation import matrix_from_quat, quat_conjugate, quat_from_matrix, quat_multiply, quat_rotate
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.metrics.convention.disagreement import LOOKS_WRONG, Case, Hypothesis, Poses, disagreement

MIN_LEVER_M = 0.05
MAX_TILT_DEG = 60.0


def _rotated(quats: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the attitudes of another frame of the rover: `R_ds_rb R_rb_other`."""
    return quat_multiply(quats, quat_from_matrix(rotation))


CONVENTIONS: tuple[tuple[str, str, str, Callable[[FloatArray, FloatArray], Poses]], ...] = (
    (
        "conjugated quaternion",
        "quaternion=conjugated",
        "its attitudes are conjugated (att_q_DsToRb written as the orientation of RB in DS): conjugate them",
        lambda p, q: (p, quat_conjugate(q)),
    ),
    (
        "scalar first",
        "quaternion=wxyz",
        "its quaternions are written scalar first (w x y z): write them scalar last (x y z w)",
        lambda p, q: (p, q[:, [1, 2, 3, 0]]),
    ),
    (
        "inverted poses",
        "inverse=true",
        "its poses are inverted (DS in RB in place of RB in DS): invert them",
        lambda p, q: (-quat_rotate(quat_conjugate(q), p), quat_conjugate(q)),
    ),
    (
        "optical axes",
        "frame=rb_optical",
        "its attitudes are those of the optical axes (x right, y down, z forward) in place of RB: rotate them to RB",
        lambda p, q: (p, _rotated(q, OPTICAL_IN_RB.T)),
    ),
    (
        "millimetres",
        "metres_per_unit=0.001",
        "its positions are in millimetres: write metres",
        lambda p, q: (p * 1e-3, q),
    ),
    (
        "kilometres",
        "metres_per_unit=1000",
        "its positions are a thousand times too small (the truth in millimetres, or kilometres): write metres",
        lambda p, q: (p * 1e3, q),
    ),
    (
        "swapped left and right images",
        "",
        "it moves backwards where the truth moves forwards: the left and right images are swapped",
        lambda p, q: (-p, q),
    ),
    (
        "mirrored left and right",
        "mirrored=true",
        "left and right are mirrored (y points right): negate y, and x and z of the quaternions",
        lambda p, q: (p * MIRROR, q * np.array([-1.0, 1.0, -1.0, 1.0])),
    ),
)
"""Mismatches that no number is fitted for: name, setting that corrects it, sentence, and how it is undone."""


def convention_hypotheses(case: Case) -> Iterator[Hypothesis]:
    """Yield the mismatches that no number is fitted for."""
    for name, setting, sentence, corrected in CONVENTIONS:
        left = disagreement(case, corrected(*case.estimate))
        yield Hypothesis(mismatch=name, sentence=f"{LOOKS_WRONG} {sentence}", disagreement=left, setting=setting)


def frame_hypotheses(case: Case, T_rb_left: Transform | None) -> Iterator[Hypothesis]:
    """Yield the mismatch of another frame of the rover: rotation known or presumed, position known or fitted."""
    camera = f"{LOOKS_WRONG} it is the pose of the left camera in place of RB"
    remedy = "transform it by the extrinsics of the camera"
    if T_rb_left is not None:
        of_rb = _extrinsics(np.eye(3), T_rb_left.translation)
        for rotation, axes, setting in (
            (T_rb_left.rotation, "optical axes", "frame=left_optical"),
            (np.eye(3), "axes of RB", of_rb),
        ):
            left = disagreement(case, _moved(case.estimate, rotation, T_rb_left.translation))
            sentence = f"{camera} ({axes}): {remedy}"
            yield Hypothesis(mismatch="left camera", sentence=sentence, disagreement=left, setting=setting)
    for rotation, axes in (
        (np.eye(3), "axes of RB"),
        (OPTICAL_IN_RB, "optical axes"),
        (_fitted_rotation(case), "tilted optical axes"),
    ):
        rotated = case.estimate[0], _rotated(case.estimate[1], rotation.T)
        lever = _fitted_lever(case, rotated)
        tilt = _angle_deg(rotation @ OPTICAL_IN_RB.T)
        if float(np.sqrt(lever @ lever)) < MIN_LEVER_M or (axes.startswith("tilted") and tilt > MAX_TILT_DEG):
            continue
        position = ", ".join(f"{value:.2f}" for value in lever)
        corrected = _moved(case.estimate, rotation, lever)
        sentence = f"{camera} or of another point ({axes}, at {position} m in RB): {remedy}"
        left, setting = disagreement(case, corrected), _extrinsics(rotation, lever)
        yield Hypothesis(mismatch="left camera", sentence=sentence, disagreement=left, fitted=True, setting=setting)


def _extrinsics(rotation: FloatArray, position: FloatArray) -> str:
    """Return the setting for poses of a frame at `rotation`, `position` in RB."""
    numbers = (*position.tolist(), *quat_from_matrix(rotation).tolist())
    return PoseConvention(extrinsics=tuple(round(number, 9) for number in numbers)).settings[0]


def _moved(est: Poses, rotation: FloatArray, lever: FloatArray) -> Poses:
    """Return the poses of RB of estimates of a frame at `rotation`, `lever` in RB."""
    quats = _rotated(est[1], rotation.T)
    return est[0] - quat_rotate(quats, np.broadcast_to(lever, est[0].shape)), quats


def _motions(case: Case, poses: Poses) -> tuple[FloatArray, FloatArray]:
    """Return rotations `(M, 3, 3)` and displacements `(M, 3)` of the sub-trajectories, in the frame of the start."""
    start, end = poses[1][case.starts], poses[1][case.ends]
    move = quat_rotate(quat_conjugate(start), poses[0][case.ends] - poses[0][case.starts])
    return matrix_from_quat(quat_multiply(quat_conjugate(start), end)), move


def _fitted_lever(case: Case, rotated: Poses) -> FloatArray:
    """Return the position `(3,)` in RB of the point whose poses are given: its displacements differ by `R l - l`."""
    turn, move = _motions(case, case.truth)
    _, seen = _motions(case, rotated)
    matrix = (turn - np.eye(3)).reshape(-1, 3)
    return np.asarray(np.linalg.lstsq(matrix, (seen - move).ravel(), rcond=1e-3)[0])


def _fitted_rotation(case: Case) -> FloatArray:
    """Return the rotation `(3, 3)` of the estimated frame on the rover: it takes directions of motion to the true ones.

    Axes of rotation and directions of displacement, weighted by their size (Kabsch 1976).
    """
    pairs = []
    for poses in (case.truth, case.estimate):
        turn, move = _motions(case, poses)
        quats = quat_from_matrix(turn)
        size = float(np.sqrt(np.square(move).sum(axis=1).mean())) or 1.0
        pairs.append(np.concatenate((quats[:, :3], move / size)))
    u, _, vt = np.linalg.svd(pairs[0].T @ pairs[1])
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def _angle_deg(rotation: FloatArray) -> float:
    return float(np.degrees(2.0 * np.arccos(np.clip(quat_from_matrix(rotation)[3], -1.0, 1.0))))
