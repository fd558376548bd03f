"""The convention mismatches that a diagnosis tries, and the correction of each.

A correction is the conversion of `metrics.conventions.pose_convention` by one setting of `PoseConvention`, so that the
correction that is evaluated is the correction that the user applies. Swapped images have no such setting. For a
mismatch of the truth, the conversion is applied to the truth, and the user must correct the file.

| mismatch | numbers fitted to the truth | is made by |
|---|---|---|
| quaternion order, inverted poses, axes, swapped or mirrored sides | none | `MISMATCHES` |
| inverted motions | none | `inverted_motions` |
| unit of the estimate or of the truth | none | `units` |
| poses of the left camera of the rig | none | `left_camera` |
| poses of a camera or of another point of the rover | lever arm, rotation | `fitted_point` |
| true poses of a camera | lever arm, rotation | `true_camera` |

To add a mismatch, add its line to `MISMATCHES`. If the mismatch depends on the compared poses or on the rig, add a
function to `DEPENDENT`. If the true attitudes are incomplete, only `LEFT_HANDED` and `units` change the disagreement,
which is then that of the positions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.rotation import (
    matrix_from_quat,
    quat_angle,
    quat_conjugate,
    quat_from_matrix,
    quat_multiply,
    quat_rotate,
)
from sfr_loc_map.geometry.stereo import OPTICAL_IN_BODY, StereoRig
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.metrics.conventions.disagreement import ComparedPoses, PoseArrays, aligned_moves, eighths
from sfr_loc_map.metrics.conventions.pose_convention import PoseConvention, poses_of_parent, poses_of_rb
from sfr_loc_map.metrics.other_formulas import relative_motions

MIN_LEVER_M = 0.05  #: Minimum fitted lever arm. Smaller lever arms are errors of extrinsics, and not another point.
AXES_FITS = 5  #: Number of alternating fits of a lever arm and a rotation.
MAX_TILT_DEG = 60.0  #: Maximum rotation of a fitted camera from forward-looking optical axes. Chosen by hand.
MIN_CORRELATION = 0.5  #: Minimum correlation of estimated and true displacements for a wrong unit; noise has about 0.
MIN_ALIGNED_CORRELATION = 0.9  #: The same after an alignment, which correlates noise. Chosen by hand.
FOOT_M = 0.3048  #: Foot, m. The US survey foot differs by 2e-6.
FOOT_WITHIN = 0.03  #: Largest relative difference of the scale from that of feet; a method has a scale error. By hand.
SPEEDS = (0.005, 40.0)  #: Range of the speed of a vehicle, from a slow rover to a car, m/s. Chosen by hand.
SPEED_QUANTILE = 0.9  #: Quantile of the speeds that is compared, because a rover may often be stationary.
IDENTITY_WITHIN = 1e-9  #: Largest position, m, and angle, rad, of a pose that is considered the identity.
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])  #: Rotation of a point of the rover with the axes of RB.
OPTICAL = quat_from_matrix(OPTICAL_IN_BODY)
RB_AXES = "axes of RB"


class Mismatch(NamedTuple):
    """A convention mismatch and its correction."""

    name: str  #: Unique among all mismatches.
    sentence: str  #: Fault of the estimate or of the truth, and its correction.
    correct: Callable[[FloatArray, FloatArray], PoseArrays]  #: Returns corrected positions and quaternions.
    setting: str = ""  #: Setting `NAME=VALUE` of `PoseConvention` for the correction; empty if there is none.
    is_fitted: bool = False  #: Whether numbers were fitted to the truth for the correction.
    is_of_truth: bool = False  #: Whether the truth has the mismatch and not the estimate.


def by_setting(name: str, setting: str, sentence: str, rig: StereoRig | None = None) -> Mismatch:
    """Return a mismatch of the estimate that a setting of `PoseConvention` corrects."""
    return Mismatch(name, sentence, _correction(PoseConvention.parse([setting]), rig), setting)


def of_truth(name: str, setting: str, sentence: str) -> Mismatch:
    """Return a mismatch of the truth. The setting corrects only estimates and is therefore not proposed."""
    return by_setting(name, setting, sentence)._replace(setting="", is_of_truth=True)


def _correction(
    convention: PoseConvention, rig: StereoRig | None = None
) -> Callable[[FloatArray, FloatArray], PoseArrays]:
    """Return the conversion of poses of a convention to poses of RB."""
    T_rb_child = convention.T_rb_child(rig)
    return lambda positions, quats: poses_of_rb(positions, quats, convention, T_rb_child)


MISMATCHES = (
    by_setting(
        "conjugated quaternion",
        "quaternion=conjugated",
        "its attitudes are conjugated (orientation of RB in DS in place of DsToRb): conjugate them",
    ),
    by_setting("scalar first", "quaternion=wxyz", "its quaternions are scalar first: write them scalar last"),
    by_setting(
        "scalar first in att_q_DsToRb",
        "quaternion=wxyz_ds_to_rb",
        "its quaternions are scalar first in the columns att_q_DsToRb: write them scalar last",
    ),
    by_setting(
        "scalar first and conjugated",
        "quaternion=conjugated_wxyz",
        "its quaternions are scalar first and conjugated: write them scalar last",
    ),
    by_setting("inverted poses", "inverse=true", "its poses are inverted (DS in RB): invert them"),
    by_setting(
        "optical axes",
        "frame=rb_optical",
        "its attitudes are those of the optical axes (x right, y down, z forward): rotate them to RB",
    ),
    Mismatch(
        "swapped left and right images",
        "it moves backwards where the truth moves forwards: the left and right images are swapped",
        lambda positions, quats: (-positions, quats),
    ),
    by_setting(
        "mirrored left and right",
        "mirrored=true",
        "left and right are mirrored (y points right): negate y, and x and z of the quaternions",
    ),
    by_setting(
        "axes of NED",
        "frame=rb_frd",
        "its attitudes are those of the axes x forward, y right, z down (NED): rotate them to RB; if the truth has "
        "these axes, --set 'truth.lever_quat_xyzw=[1, 0, 0, 0]' corrects the truth",
    ),
    of_truth(
        "truth with optical axes",
        "frame=rb_optical",
        "its attitudes are those of the optical axes of a camera (x right, y down, z forward): --set "
        f"'truth.lever_quat_xyzw={[round(number, 3) for number in OPTICAL.tolist()]}' corrects the truth",
    ),
    of_truth(
        "truth with conjugated quaternions",
        "quaternion=conjugated",
        "its attitudes are conjugated (rotation from DS to RB in place of the orientation of RB in DS): conjugate them",
    ),
    of_truth("inverted truth", "inverse=true", "its poses are inverted (DS in RB): invert them"),
    of_truth(
        "truth scalar first",
        "quaternion=wxyz",
        "its quaternions are scalar first: write them scalar last, or name the columns (option --columns "
        "'truth:t,x,y,z,qw,qx,qy,qz')",
    ),
)
"""The mismatches that do not depend on the compared poses."""
LEFT_HANDED = of_truth(
    "left-handed truth",
    "mirrored=true",
    "its axes are left-handed: exchange the columns of x and y, or negate one axis (an estimate from swapped left and "
    "right images has the same error)",
)
"""Mismatch of true positions without attitudes. With attitudes, `MISMATCHES` attributes the error to the estimate."""


def mismatches_of(compared: ComparedPoses) -> Iterator[Mismatch]:
    """Yield the mismatches that the compared poses can show; there are at least `MIN_POSES` frames."""
    if not compared.has_attitudes:
        yield LEFT_HANDED
        yield from units(compared)
        return
    yield from MISMATCHES
    for mismatches in DEPENDENT:
        yield from mismatches(compared)


# ---- mismatches that depend on the compared poses or on the rig


def inverted_motions(compared: ComparedPoses) -> Iterator[Mismatch]:
    """Yield inverted motions, unless the first pose is the identity, because they then equal inverted poses."""
    first = compared.estimate.positions[0], compared.estimate.quats_xyzw[0]
    if np.abs(first[0]).max() + quat_angle(first[1]) > IDENTITY_WITHIN:
        sentence = "its motions since the first pose are inverted: invert them"
        yield by_setting("inverted motions", "inverse_motion=true", sentence)


def units(compared: ComparedPoses) -> Iterator[Mismatch]:
    """Yield the mismatches of positions in a unit other than the metre.

    The ratio of the sizes does not show whether estimate or truth has the wrong unit. The estimate is corrected only if
    the truth has the speed of a vehicle and the estimate does not. Otherwise a mismatch of the truth is reported,
    without a setting.
    """
    scale = _scale_of_truth(compared)
    if scale is None:
        return
    if abs(scale * FOOT_M - 1.0) < FOOT_WITHIN:
        sentence = "its positions are in feet: convert them to metres"
        yield of_truth("truth in feet", f"metres_per_unit={FOOT_M}", sentence)
    if abs(scale / FOOT_M - 1.0) < FOOT_WITHIN:
        yield by_setting("feet", f"metres_per_unit={FOOT_M}", "its positions are in feet: write metres")
    if _has_speed_of_vehicle(compared.truth) and not _has_speed_of_vehicle(compared.estimate):
        for unit, metres in (("millimetres", "0.001"), ("kilometres", "1000")):
            sentence = f"its positions are in {unit}: write metres"
            yield by_setting(unit, f"metres_per_unit={metres}", sentence)
        return
    for unit, metres, otherwise in (("kilometres", "1000", "millimetres"), ("millimetres", "0.001", "kilometres")):
        sentence = f"its positions are in {unit}, or those of the estimate in {otherwise}: write metres"
        yield of_truth(f"truth in {unit}", f"metres_per_unit={metres}", sentence)


def _scale_of_truth(compared: ComparedPoses) -> float | None:
    """Return the size of the true displacements relative to the estimated ones; None if their directions differ.

    The displacements of a stationary rover are noise. Without this condition the unit millimetre would explain this
    noise, because a smaller unit reduces it.
    """
    if compared.has_attitudes:
        least = MIN_CORRELATION
        true_moves, moves = _motions(compared.true).moves, _motions(compared.found).moves
    else:
        least = MIN_ALIGNED_CORRELATION
        has_height = compared.truth.has_height
        true_moves, moves = aligned_moves(compared.true[0][None], compared.found[0], has_height=has_height)
    true_m = float(np.linalg.norm(true_moves))
    found_m = float(np.linalg.norm(moves))
    return true_m / found_m if (true_moves * moves).sum() > least * true_m * found_m else None


def _has_speed_of_vehicle(poses: Trajectory) -> bool:
    """Return whether the positions have the speed of a vehicle if they are in metres; poses are in time order.

    The quantile `SPEED_QUANTILE` of the speeds between successive poses is compared.
    """
    steps = np.linalg.norm(np.diff(poses.positions, axis=0), axis=1)
    speed = float(np.quantile(steps / (np.diff(poses.stamps_ns) / NS_PER_S), SPEED_QUANTILE))
    return SPEEDS[0] <= speed <= SPEEDS[1]


def left_camera(compared: ComparedPoses) -> Iterator[Mismatch]:
    """Yield the mismatches in which the poses are those of the left camera: with optical axes, or with axes of RB."""
    rig = compared.rig
    if rig is None or rig.T_rb_sb is None:
        return
    setting = "frame=left_optical"
    yield by_setting("left camera, optical axes", setting, _of_point("the left camera", "optical axes"), rig)
    lever_m = PoseConvention.parse([setting]).T_rb_child(rig).translation
    sentence = _of_point("the left camera", "axes of RB")
    yield _by_extrinsics("left camera, axes of RB", sentence, lever_m, UPRIGHT)


def fitted_point(compared: ComparedPoses) -> Iterator[Mismatch]:
    """Yield the mismatches in which the poses are those of a camera or another point, with fitted extrinsics."""
    for axes, lever_m, turn in _fitted_extrinsics(compared.true, compared.found):
        position = ", ".join(f"{value:.2f}" for value in lever_m)
        sentence = _of_point("another point", f"{axes}, at {position} m in RB")
        yield _by_extrinsics(f"another point, {axes}", sentence, lever_m, turn)._replace(is_fitted=True)


def true_camera(compared: ComparedPoses) -> Iterator[Mismatch]:
    """Yield the mismatches in which the true poses are those of a camera, with fitted extrinsics."""
    for axes, lever_m, turn in _fitted_extrinsics(compared.found, compared.true):
        if axes == RB_AXES:
            continue  # `fitted_point` has the same evidence, and no camera
        lever, quat = ([round(number, 3) for number in numbers.tolist()] for numbers in (lever_m, turn))
        sentence = (
            f"its poses are those of a camera in place of RB ({axes}): --set 'truth.lever_arm_m=X' --set "
            f"'truth.lever_quat_xyzw=Q' with the pose of the camera in RB corrects the truth; fitted are X={lever} and "
            f"Q={quat}"
        )
        mismatch = _by_extrinsics(f"truth of a camera, {axes}", sentence, lever_m, turn)
        yield mismatch._replace(setting="", is_fitted=True, is_of_truth=True)


def _fitted_extrinsics(of_rb: PoseArrays, of_point: PoseArrays) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield the fitted lever arm, m, and rotation of a point of the rover, with the names of its axes."""
    rb, point = _motions(of_rb), _motions(of_point)
    axes = {RB_AXES: UPRIGHT, "optical axes": OPTICAL}
    fitted = _fitted_axes(rb, point)
    tilt_deg = float(np.degrees(quat_angle(quat_multiply(fitted, quat_conjugate(OPTICAL)))))
    if tilt_deg <= MAX_TILT_DEG:
        axes["tilted optical axes"] = fitted
    for name, turn in axes.items():
        lever_m = _fitted_lever_arm(rb, point, turn)
        if float(np.linalg.norm(lever_m)) >= MIN_LEVER_M:
            yield name, lever_m, turn


class _Motions(NamedTuple):
    """The motions over the sub-trajectories, in the frame of their start."""

    turns: FloatArray  #: Quaternions `(M, 4)` with a scalar part >= 0.
    moves: FloatArray  #: Displacements `(M, 3)`, m.

    @property
    def directions(self) -> FloatArray:
        """The rotation axes and the displacements `(M, 6)`, weighted by their size."""
        size = float(np.sqrt(np.square(self.moves).sum(axis=1).mean())) or 1.0
        return np.concatenate((self.turns[:, :3], self.moves / size))


def _motions(poses: PoseArrays) -> _Motions:
    """Return the motions over the sub-trajectories of poses."""
    positions, attitudes = poses
    starts, ends = eighths(len(positions))
    moves, turns = relative_motions(positions, attitudes, starts, ends)
    return _Motions(np.where(turns[:, 3:] < 0.0, -turns, turns), moves)


def _fitted_axes(rb: _Motions, point: _Motions) -> FloatArray:
    """Return the rotation of the tracked body relative to RB.

    The rotation and the lever arm are fitted alternately, because the lever arm changes the displacements.
    """
    turn = _fitted_rotation(rb, point)
    for _ in range(AXES_FITS):
        lever_m = _fitted_lever_arm(rb, point, turn)
        of_point = rb._replace(moves=rb.moves + quat_rotate(rb.turns, lever_m) - lever_m)
        turn = _fitted_rotation(of_point, point)
    return turn


def _fitted_rotation(true: _Motions, found: _Motions) -> FloatArray:
    """Return the rotation that aligns the directions of estimated motions with those of true motions (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(true.directions.T @ found.directions)
    return quat_from_matrix(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def _fitted_lever_arm(true: _Motions, found: _Motions, turn: FloatArray) -> FloatArray:
    """Return the lever arm l, m, of a point with this rotation. Displacements differ from those of RB by `R l - l`."""
    matrix = (matrix_from_quat(true.turns) - np.eye(3)).reshape(-1, 3)
    differences = quat_rotate(turn, found.moves) - true.moves
    return np.asarray(np.linalg.lstsq(matrix, differences.ravel(), rcond=1e-3)[0])


def _of_point(point: str, place: str) -> str:
    return f"its poses are those of {point} in place of RB ({place}): transform them by the extrinsics of the point"


def _by_extrinsics(name: str, sentence: str, lever_m: FloatArray, turn: FloatArray) -> Mismatch:
    """Return the mismatch in which the poses are those of a point with this pose in RB.

    The setting is empty if a lever arm is larger than `PoseConvention` accepts, for example because the positions are
    in millimetres.
    """
    numbers = tuple(round(number, 9) for number in (*lever_m.tolist(), *turn.tolist()))
    T_rb_point = Transform.from_quat(numbers[:3], numbers[3:])
    try:
        (setting,) = PoseConvention(extrinsics=numbers).settings
    except ConfigError:
        setting = ""
    return Mismatch(name, sentence, lambda positions, quats: poses_of_parent(positions, quats, T_rb_point), setting)


DEPENDENT: tuple[Callable[[ComparedPoses], Iterator[Mismatch]], ...] = (
    inverted_motions,
    units,
    left_camera,
    fitted_point,
    true_camera,
)
"""Functions that yield the mismatches that the compared poses can show."""
