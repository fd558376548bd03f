"""The rectified stereo rig and its image pairs."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from sfr_loc_map.errors import GeometryError
from sfr_loc_map.geometry.arrays import FloatArray, GreyImage, PointImage, check_numbers, kind_of
from sfr_loc_map.geometry.camera import StereoCamera
from sfr_loc_map.geometry.plausibility import BASELINE_M, check_camera, check_extrinsics
from sfr_loc_map.geometry.transform import Transform

OPTICAL_IN_BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from optical axes (x right, y down, z forward) to axes x forward, y left, z up, such as SB [3.2.3]."""
SAME_PX = 0.01
"""Rigs are equal if camera matrix and largest disparity differ by less than this, pixels."""
MIN_SIDE_PX = 16
"""Minimum width and height of images that are localised or mapped, pixels. The coarsest level of an image pyramid then
has a side of at least two pixels."""
CAMERA = ("width", "height", "fx", "fy", "cx", "cy", "baseline_m")  #: Fields of a rig without its pose.


@dataclass(frozen=True, slots=True, eq=False)
class StereoRig:
    """A rectified stereo rig: both cameras have the same camera matrix, and image rows are epipolar lines.

    Pixel centres are at integer coordinates: `u = fx X / Z + cx`, with X and Z in the left optical frame (x right, y
    down, z forward). The disparity is `u_left - u_right = fx baseline_m / Z`. Sizes, focal lengths and principal point
    are in pixels.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    baseline_m: float  #: Distance between the optical centres, metres.
    #: Pose of SB in RB; None if unknown. Required only for localisation, where SB is LOCSB.
    T_rb_sb: Transform | None = None

    def __post_init__(self) -> None:
        """Check the values; GeometryError if a value is implausible for a camera or a rover."""
        check_numbers(width=self.width, height=self.height, fx=self.fx, fy=self.fy, cx=self.cx, cy=self.cy)
        check_numbers(baseline=self.baseline_m)
        check_camera((self.width, self.height), (self.fx, self.fy), (self.cx, self.cy))
        low, high = BASELINE_M
        if not low <= self.baseline_m <= high:
            raise GeometryError(f"baseline is {self.baseline_m:g} m: {low:g} to {high:g} m is required")
        if not isinstance(self.T_rb_sb, Transform | None):
            raise GeometryError(f"T_rb_sb has the type {kind_of(self.T_rb_sb)}: a Transform or None is required")
        if self.T_rb_sb is not None:
            check_extrinsics(self.T_rb_sb.translation)

    @property
    def camera_matrix(self) -> FloatArray:
        """Camera matrix `(3, 3)` of both cameras, pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def camera(self) -> StereoCamera:
        """The cameras as a named tuple for kernels."""
        return StereoCamera(self.fx, self.fy, self.cx, self.cy, self.baseline_m)

    @property
    def T_sb_left(self) -> Transform:
        """Pose of the left optical frame in SB, which has x forward, y from right to left camera, z up [3.2.3]."""
        return Transform(OPTICAL_IN_BODY.copy(), np.array([0.0, 0.5 * self.baseline_m, 0.0]))

    @property
    def T_rb_left(self) -> Transform:
        """Pose of the left optical frame in RB; GeometryError if the pose of the rig in RB is unknown."""
        if self.T_rb_sb is None:
            raise GeometryError(
                "the pose of the cameras on the rover (T_rb_locsb) is unknown: set extrinsics.translation_m and "
                "extrinsics.quat_xyzw in sfr.yaml, or add T_rb_locsb to rig.json, or the transform from rb to locsb to "
                "/tf_static"
            )
        return self.T_rb_sb @ self.T_sb_left

    @property
    def fingerprint(self) -> str:
        """Hash of all values of the rig. Files identify the rig by this hash."""
        numbers = [self.width, self.height, *self.camera]
        if self.T_rb_sb is not None:
            numbers += [*self.T_rb_sb.translation.tolist(), *self.T_rb_sb.rotation.reshape(-1).tolist()]
        return hashlib.sha256(",".join(float(n).hex() for n in numbers).encode()).hexdigest()[:16]

    def fault_of_size(self, image: GreyImage) -> str:
        """Return why an image does not fit the rig; empty if the sizes are equal.

        The text continues a message that begins with the name of the image.
        """
        if image.shape == (self.height, self.width):
            return ""
        found = f"{image.shape[1]} x {image.shape[0]}"
        return (
            f"is {found}: {self.width} x {self.height}, the size of the rig, is required; use the rig of these images"
        )

    def same_cameras(self, other: StereoRig) -> bool:
        """Return whether the cameras of both rigs agree within `SAME_PX`, because drivers round the calibration."""
        if (self.width, self.height) != (other.width, other.height):
            return False
        largest_disparity_change_px = self.width * (other.baseline_m / self.baseline_m - 1.0)
        changes_px = (other.fx - self.fx, other.fy - self.fy, other.cx - self.cx, other.cy - self.cy)
        return all(abs(change_px) < SAME_PX for change_px in (*changes_px, largest_disparity_change_px))


def check_rig(rig: object) -> None:
    """Check the rig of a localiser or mapper; GeometryError if it is not a `StereoRig` or its images are too small."""
    if not isinstance(rig, StereoRig):
        raise GeometryError(f"the rig has the type {type(rig).__name__}: a StereoRig is required")
    if min(rig.width, rig.height) < MIN_SIDE_PX:
        raise GeometryError(
            f"the images of the rig are {rig.width} x {rig.height} px: at least {MIN_SIDE_PX} x {MIN_SIDE_PX} px are "
            "required"
        )


@dataclass(frozen=True, slots=True, eq=False)
class StereoPair:
    """Two rectified grey images `(H, W)`, taken at the same time."""

    stamp_ns: int
    left: GreyImage
    right: GreyImage

    def __post_init__(self) -> None:
        """Check types and sizes; GeometryError if an image is not 2D uint8, sizes differ or the stamp is not an int."""
        if not isinstance(self.stamp_ns, int | np.integer):
            raise GeometryError(f"stamp {self.stamp_ns!r} of a pair: whole nanoseconds are required")
        for name, image in (("left", self.left), ("right", self.right)):
            if not isinstance(image, np.ndarray) or image.ndim != 2 or image.dtype != np.uint8:
                raise GeometryError(
                    f"{name} image of stamp {self.stamp_ns} is {kind_of(image)}: a grey image uint8 (H, W) is required"
                )
        if self.left.shape != self.right.shape:
            raise GeometryError(
                f"left and right image of stamp {self.stamp_ns} have the sizes {self.left.shape[::-1]} and "
                f"{self.right.shape[::-1]}: the size of the rig is required for both"
            )


@dataclass(frozen=True, slots=True, eq=False)
class PosedStereoPair:
    """A stereo pair for mapping, with the pose of the rig in the local map frame.

    Methods under test receive the pair and the pose. The truth is used only by the score.
    """

    pair: StereoPair
    T_lm_navsb: Transform
    truth: PointImage | None = None  #: True points in LM at the centres of the left pixels; None if unknown.
