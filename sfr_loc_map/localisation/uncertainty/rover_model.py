"""The rover model of the localiser: extrinsics and geometry of the cameras, bounds of the motion, error sources."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.config import MotionBounds
from sfr_loc_map.localisation.motion_size import MotionSize
from sfr_loc_map.localisation.symmetric_matrices import symmetric
from sfr_loc_map.localisation.uncertainty.error_sources import ErrorSources


@dataclass(frozen=True, slots=True, eq=False)
class RoverModel:
    """Constants of a run, which the motion model and the covariances share."""

    T_rb_left: Transform  #: Takes points in the left optical frame to RB.
    T_left_rb: Transform  #: Takes points in RB to the left optical frame.
    fx: float  #: Focal length, px.
    focal_baseline: float  #: Focal length times baseline, px m.
    keyframe_rad: float  #: Optical flow that triggers a keyframe, rad.
    bounds: MotionBounds
    sources: ErrorSources = ErrorSources()

    @classmethod
    def of(cls, rig: StereoRig, bounds: MotionBounds, keyframe_flow_ratio: float) -> RoverModel:
        """Return the model of a rig; GeometryError if the extrinsics are unknown.

        `keyframe_flow_ratio` is the optical flow that triggers a keyframe, as a fraction of the image width.
        """
        return cls(
            T_rb_left=rig.T_rb_left,
            T_left_rb=rig.T_rb_left.inverse(),
            fx=rig.fx,
            focal_baseline=rig.fx * rig.baseline_m,
            keyframe_rad=keyframe_flow_ratio * rig.width / rig.fx,
            bounds=bounds,
        )

    def blur(self, depth_m: float) -> MotionSize:
        """Return the standard deviations that an error of the whole image causes in a pose, for the median depth Z_map.

            blur = (Z_map blur_px / f, blur_px / f)

        An error of a whole image rotates all landmarks by blur_px / f. The pose is displaced by this angle times Z_map.
        """
        blur_rad = self.sources.blur_px / self.fx
        return MotionSize(blur_rad * depth_m, blur_rad)

    def lens_turn_per_m(self, calibration: OnlineCalibration) -> float:
        """Return the rotation per metre, rad/m, by which residual lens distortion bends the path.

            lens_turn = hypot(lens_px, lens_ratio RMS of the residual disparities) / (f b)

        If landmarks are too near on one side and too far on the other by 1 px of disparity, each step is turned by
        its length / (f b), rad.
        """
        lens_px = np.hypot(self.sources.lens_px, self.sources.lens_ratio * calibration.lens.rms_px)
        return float(lens_px / self.focal_baseline)

    def covariance_of_left(
        self, covariance: FloatArray, *, R_world_frame: FloatArray, R_world_left: FloatArray
    ) -> FloatArray:
        """Return the covariance of the left camera in the world from that of RB in another frame."""
        lever = R_world_left @ self.T_rb_left.rotation.T @ self.T_rb_left.translation
        return symmetric(propagated_covariance(covariance, lever, R_world_frame))

    def covariance_at(self, T_world_left: Transform, covariance: FloatArray) -> FloatArray:
        """Return the covariance of the left camera in the world from that of RB in RB, at a pose of the left camera."""
        R_world_left = T_world_left.rotation
        R_world_rb = R_world_left @ self.T_rb_left.rotation.T
        return self.covariance_of_left(covariance, R_world_frame=R_world_rb, R_world_left=R_world_left)
