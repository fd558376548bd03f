"""The pose published last, and the steps from this pose to the next one (table in `uncertainty`)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.localisation.estimate import StepEstimate
from sfr_loc_map.localisation.motion_size import MotionSize, Speed
from sfr_loc_map.localisation.uncertainty.accepted_pair import AcceptedPair
from sfr_loc_map.localisation.uncertainty.correlated_error import ZERO
from sfr_loc_map.localisation.uncertainty.inflation import AddedError, unobserved_during
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel
from sfr_loc_map.localisation.uncertainty.step_covariance import (
    MIN_VARIANCE,
    StepMotion,
    pose_noise,
    step_covariance,
    systematic_step,
    updated_variance_factor,
)
from sfr_loc_map.message_stamps import NS_PER_S


@dataclass(frozen=True, slots=True, eq=False)
class PublishedPose:
    """The last published pose that was not lost, at which the next step starts."""

    stamp_ns: int | None = None  #: Stamp of the pose; None before the first pose.
    T_world_left: Transform | None = None  #: The pose as it was published; adjustments do not move it.
    #: Covariance `(6, 6)` of errors that concern this pose alone, in RB at the pose before this pose: the inflation by
    #: findings, and the displacement by a correction of the yaw. Such an error is part of the step to this pose and,
    #: with the opposite sign, of the next step. The covariance is therefore added to both, and the rotation of the
    #: step between the two is neglected.
    shared_with_next_step: FloatArray = field(default_factory=lambda: ZERO)
    #: Time for which the last known pose was kept up to this pose, s; 0 if the pair of this pose was accepted or began
    #: a window. The next step contains the unobserved motion during this time.
    kept_s: float = 0.0
    noise: FloatArray = field(default_factory=lambda: ZERO)  #: White noise `(6, 6)` of this pose, in RB at this pose.
    variance_factor: float | None = None  #: Variance factor (`step_covariance`); None before the first residuals.

    def seconds_until(self, stamp_ns: int) -> float:
        """Return the time from this pose to a stamp, s; 0 before the first pose."""
        return 0.0 if self.stamp_ns is None else (stamp_ns - self.stamp_ns) / NS_PER_S

    def accepted(
        self, pair: AcceptedPair, speed: Speed, added: AddedError, model: RoverModel
    ) -> tuple[PublishedPose, StepEstimate]:
        """Return the pose of an accepted pair, and the step to it.

        The step to the first pose is from that pose to itself, so that its motion is zero.

        Args:
            pair: The pair.
            speed: Last speed before the pair.
            added: What the findings of the pair add.
            model: Extrinsics, camera geometry, bounds and error sources.
        """
        variance_factor = updated_variance_factor(self.variance_factor, pair.chi_median, model.sources)
        noise = pose_noise(
            pair.given_keyframes,
            R_world_left=pair.T_world_left.rotation,
            variance_factor=variance_factor,
            shear_chi2=pair.shear_chi2,
            model=model,
        )
        published = PublishedPose(
            stamp_ns=pair.stamp_ns,
            T_world_left=pair.T_world_left,
            shared_with_next_step=added.of_step,
            noise=noise,
            variance_factor=variance_factor,
        )
        motion = StepMotion.between(self.T_world_left or pair.T_world_left, pair.T_world_left, model)
        depth_m = pair.tracks.landmarks.median_depth
        keyframes = pair.landmark_map.window.last_motion
        of_images = step_covariance(motion, keyframes, pair.given_keyframes, depth_m, variance_factor, model)
        seconds = self.seconds_until(pair.stamp_ns)
        while_kept = unobserved_during(speed, self.kept_s, model) if self.kept_s > 0.0 else ZERO
        step = StepEstimate(
            seconds=seconds,
            motion=motion.vector,
            covariance=of_images + self.shared_with_next_step + while_kept + published.shared_with_next_step,
            systematic=systematic_step(motion, depth_m, pair.calibration, model),
            noise=noise.copy(),  # a caller may overwrite the arrays of a step
            noise_before=self.noise.copy(),
            speed_change=ZERO if pair.was_known else unobserved_during(speed, seconds, model),
        )
        return published, step

    def kept(
        self, stamp_ns: int, T_world_left: Transform, *, unobserved_s: float, speed: Speed, model: RoverModel
    ) -> tuple[PublishedPose, StepEstimate]:
        """Return the last known pose, kept at a stamp, and the step to it.

        The motion of the step is the displacement of the pose by an adjustment of its keyframe; zero without
        adjustment. The covariance of the step is the growth of the covariance of the unobserved motion.

        Args:
            stamp_ns: Stamp at which the pose is kept.
            T_world_left: Last known pose of the left camera in the world.
            unobserved_s: Time between the last known pose and the stamp.
            speed: Last speed.
            model: Extrinsics, bounds and error sources.
        """
        seconds = self.seconds_until(stamp_ns)
        added = unobserved_during(speed, unobserved_s, model) - unobserved_during(speed, self.kept_s, model)
        # both are diagonal, so that the larger elements form a covariance
        growth = np.maximum(added, unobserved_during(speed, seconds, model))
        motion = np.zeros(6)
        if self.T_world_left is not None:
            motion = StepMotion.between(self.T_world_left, T_world_left, model).vector
        step = StepEstimate(
            seconds=seconds,
            motion=motion,
            covariance=growth + MIN_VARIANCE * np.eye(6),
            systematic=np.zeros(6),
            noise=self.noise.copy(),
            noise_before=self.noise.copy(),
            speed_change=ZERO,
        )
        kept = replace(self, stamp_ns=stamp_ns, T_world_left=T_world_left, kept_s=unobserved_s)
        return kept, step

    def window_begun(self) -> PublishedPose:
        """Return the pose of a pair that begins a window.

        The next step is measured from the image of this pair. It therefore contains no errors and no noise of the
        earlier poses.
        """
        return replace(self, shared_with_next_step=ZERO, kept_s=0.0, noise=ZERO)

    def adjusted(self, moved: MotionSize) -> PublishedPose:
        """Return the pose after the last known pose was displaced by a change of the yaw correction.

        The covariance of the next step to a new pose grows by the square of the displacement. If the pose is kept
        first, the step to the kept pose contains the displacement itself, and its covariance is that of an unobserved
        motion.
        """
        return replace(self, shared_with_next_step=self.shared_with_next_step + moved.covariance)
