"""Covariance of a pose: the errors of the present pose, accumulated along the path, and the terms composed from them.

Positions are `(3,)`, m, in the world. A covariance `(6, 6)` is that of position and rotation about fixed axes, for the
left camera in the world.

An attitude error displaces later positions. The terms `external` and `keyframes` are therefore propagated from the
position where the error arose to the present position (`LocatedCovariance`). The term `correlated` is propagated from
the mean of the positions where its angles arose (`PathSums.correlated_at`). The term `attitude` is not propagated,
because this error concerns the present rotation only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, diagonal_matrix, length, outer_square, read_only
from sfr_loc_map.geometry.transform import Transform, propagated_covariance, symmetric
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.findings import Inflation
from sfr_loc_map.localisation.frontend.right_camera import RowShear
from sfr_loc_map.localisation.motion_size import NO_MOTION, MotionSize
from sfr_loc_map.localisation.uncertainty.error_sources import ZERO, AddedError, ErrorSources, RoverModel

ZERO_VECTOR = read_only(np.zeros(3))  #: Origin of the world, m, or a sum without steps.


class AcceptedPair(NamedTuple):
    """A pair whose pose was accepted: what its errors depend on (`State.accepted` collects the values)."""

    stamp_ns: int
    T_world_left: Transform  #: Pose of the left camera in the world.
    given_keyframes: FloatArray  #: Covariance `(6, 6)` of the pose given the keyframes.
    tracked_depth_m: float  #: Median depth of the landmarks that were searched for.
    chi_median: float  #: Median squared residual per degree of freedom (`Tracks.chi_median`).
    landmark_map: LandmarkMap  #: Map in which the pose was estimated.
    calibration: OnlineCalibration  #: The calibration, updated by the pair.
    was_known: bool  #: Whether the previous pose was known (tracked or kept, not lost).
    shear: RowShear  #: Shear of the rows of the images.
    inflation: Inflation  #: What the findings of the pair add to the covariance.
    other_distance: MotionSize  #: Distance to the pose of another possible motion; zero if none was found.


class LocatedCovariance(NamedTuple):
    """Covariance `(6, 6)` of a pose, and the position `(3,)`, m, where the error arose."""

    position: FloatArray
    covariance: FloatArray

    def at(self, position: FloatArray) -> FloatArray:
        """Return the covariance propagated to another position, which a rotation error displaces."""
        return propagated_covariance(self.covariance, position - self.position)


NOTHING = LocatedCovariance(ZERO_VECTOR, ZERO)  #: No error.


class PathSums(NamedTuple):
    """Sums over all steps of a run. No event resets them: an error since a reference is the difference of two sums."""

    bias: FloatArray = ZERO_VECTOR  #: Position error per pixel of a constant disparity error, m/px.
    corrected: FloatArray = ZERO_VECTOR  #: Position error per pixel times the yaw correction at the step, m.
    drift_px: float = 0.0  #: Sum of the absolute drift corrections of the right camera, px.
    correlated: MotionSize = NO_MOTION  #: Ambiguous motions, and bending of the path by the lens.
    #: Sum over the steps of the angle of the correlated errors times the position at the step, rad m.
    turned: FloatArray = ZERO_VECTOR

    def correlated_at(self, position: FloatArray) -> FloatArray:
        """Return the covariance `(6, 6)` of the correlated errors at a position: the term `correlated` of a pose.

            correlated = diag(metres, metres, metres, radians, radians, radians)^2, propagated from `turned` / radians

        All angles have the same unknown axis. Together they are one rotation about the mean of the positions where they
        arose, weighted by the angles.
        """
        covariance = self.correlated.covariance
        if self.correlated.radians <= 0.0:
            return covariance
        return propagated_covariance(covariance, position - self.turned / self.correlated.radians)

    def since(self, earlier: PathSums) -> PathSums:
        """Return what was added since an earlier pose."""
        return PathSums(
            self.bias - earlier.bias,
            self.corrected - earlier.corrected,
            self.drift_px - earlier.drift_px,
            self.correlated.minus(earlier.correlated),
            self.turned - earlier.turned,
        )


def sums_after_step(
    before: PathSums,
    *,
    position: FloatArray,
    displacement: FloatArray,
    depth_m: float,
    ambiguity: MotionSize,
    calibration: OnlineCalibration,
    model: RoverModel,
) -> PathSums:
    """Return the sums after a step.

        bias       += Z_map / (f b) displacement
        corrected  += corrected_px Z_map / (f b) displacement
        correlated += (0, lens_turn length of the displacement) + ambiguity
        turned     += (angle of the added correlated error) position
        drift_px    = drift.total_px, which is a sum itself (`DriftEstimate`)

    A step backwards undoes the turn of a step forwards (`systematic_step`). The length in `correlated` has no sign, so
    that the sum is an upper bound if the path has steps in both directions.

    Args:
        before: Sums before the step.
        position: `(3,)` position after the step, m.
        displacement: `(3,)` displacement of the left camera in the world, m.
        depth_m: Median depth of the landmarks of the map.
        ambiguity: Error if another motion is the true motion; zero if no finding requires this error.
        calibration: The calibration after the step.
        model: Camera geometry and error sources.
    """
    m_per_px = displacement * depth_m / model.focal_baseline
    bending = MotionSize(0.0, model.lens_turn_per_m(calibration) * length(displacement))
    correlated = bending.plus(ambiguity)
    return PathSums(
        bias=before.bias + m_per_px,
        corrected=before.corrected + m_per_px * calibration.yaw.corrected_px,
        drift_px=calibration.drift.total_px,
        correlated=before.correlated.plus(correlated),
        turned=before.turned + correlated.radians * position,
    )


class Origin(NamedTuple):
    """The external pose to which the covariance is relative: the start of the run, or a pose that was set later."""

    external: LocatedCovariance  #: Covariance of the external pose.
    #: `(6, 6)` covariance that the next accepted pair adds to `external`; None for nothing. An external pose that is
    #: later than the last accepted pair is exact for the present pose, but later poses continue from that pair (`path`)
    #: and contain its errors, and the unobserved motion from that pair to the external pose.
    added_by_next: FloatArray | None = None
    of_map: LocatedCovariance = NOTHING  #: `PathErrors.of_map` at the external pose.
    sums: PathSums = PathSums()  #: Sums over the steps up to the external pose.

    def accepted(self) -> Origin:
        """Return the external pose after a pair was accepted."""
        if self.added_by_next is None:
            return self
        external = self.external._replace(covariance=self.external.covariance + self.added_by_next)
        return self._replace(external=external, added_by_next=None)

    def window_begun(self) -> Origin:
        """Return the external pose after a window began at the present pose, from which later poses continue."""
        return self._replace(added_by_next=None)


class PathErrors(NamedTuple):
    """Errors of the present pose.

    The table shows how each event changes each component: `=` sets the component, `+` adds to the component, `0` sets
    the component to zero. Other components stay as they are.

    | component | `accepted` | `kept` | `adjusted` | `window_begun` | `reset` | `anchored` |
    |---|---|---|---|---|---|---|
    | `origin` | `external` + `added_by_next` | | | `added_by_next` = None | = new | = new |
    | `before_window` | | | | + `in_window`, `this_pair`, `kept_motion`, first image | 0 | |
    | `in_window` | | | = keyframe | = keyframe | 0 | |
    | `of_landmarks` | = tracks | | 0 | 0 | 0 | 0 at the last pair |
    | `blur` | = image | | | = first image | 0 | 0 at the last pair |
    | `unobserved_motion` | = motion or 0 | | | 0 | 0 | 0 at the last pair |
    | `kept_motion` | 0 | = motion | | 0 | 0 | |
    | `sums` | + step | | | | | |

    | event | is |
    |---|---|
    | `accepted` | a pair is accepted |
    | `kept` | the last pose is published again at a pair, or an external pose is applied to this kept pose |
    | `adjusted` | the bundle adjustment of a keyframe in the background has ended |
    | `window_begun` | a pair begins a window at the last pose |
    | `reset` | an external pose is applied to the last pose; the map and the earlier path are discarded |
    | `anchored` | an external pose is applied to a past pose, and the map is kept |

    A lost pair changes no component. An adjustment does not change `unobserved_motion`, because the images of the
    keyframe may still be partly stale.
    """

    origin: Origin  #: The external pose to which the covariance is relative.
    #: Covariance at the start of the present window: what earlier windows, their first images, and the motions
    #: between windows have added since the start of the run or the last `reset`.
    before_window: LocatedCovariance = NOTHING
    #: Covariance of the newest keyframe in its window, from the bundle adjustment, times `adjustment_inflation`.
    in_window: FloatArray = ZERO
    #: Covariance of the present pose given the keyframes (`given_keyframes`), times `adjustment_inflation`.
    of_landmarks: FloatArray = ZERO
    blur: FloatArray = ZERO  #: Covariance of errors of the whole image.
    #: Covariance of the motion to the present pose, if the findings require that this motion counts as unobserved.
    unobserved_motion: FloatArray = ZERO
    #: Covariance of the motion while the pose is kept. After an external pose, the motion counts from its stamp. The
    #: next step contains the whole motion since the last known pose instead (`PublishedPose.kept_s`).
    kept_motion: FloatArray = ZERO
    sums: PathSums = PathSums()  #: Sums over the steps up to the present pose.

    @property
    def this_pair(self) -> FloatArray:
        """Covariance `(6, 6)` of the errors of the present pose that no other pose shares: the term `this_pair`.

            this_pair = adjustment_inflation given_keyframes + blur + unobserved_motion

        `blur` is (Z_map blur_px / f)^2 in position and (blur_px / f)^2 in rotation (`RoverModel.blur`).
        """
        return self.of_landmarks + self.blur + self.unobserved_motion

    def of_map(self, position: FloatArray) -> LocatedCovariance:
        """Return the covariance that the map has accumulated since its beginning, at a position.

            of_map = before_window + adjustment_inflation (covariance of the newest keyframe in its window)

        The present pose shares these errors with its keyframe. External poses that anchor the map do not reset the
        errors. The difference of `of_map` at two poses is therefore the covariance that arose between the two poses.
        """
        return LocatedCovariance(position, self.before_window.at(position) + self.in_window)

    def of_keyframes(self, position: FloatArray) -> FloatArray:
        """Return the covariance `(6, 6)` that the map has accumulated since the external pose: the term `keyframes`.

            keyframes = positive part of (of_map - of_map of the origin)

        Both covariances are propagated to the position. The origin is the external pose.
        """
        return _positive_part(self.of_map(position).covariance - self.origin.of_map.at(position))

    def accepted(
        self, pair: AcceptedPair, T_world_left_before: Transform, added: AddedError, model: RoverModel
    ) -> PathErrors:
        """Return the errors of the pose of an accepted pair.

        Args:
            pair: The pair.
            T_world_left_before: Last known pose, where the step to the pair begins.
            added: What the findings of the pair add.
            model: Camera geometry and error sources.
        """
        position = pair.T_world_left.translation
        depth_m = pair.landmark_map.landmarks.median_depth
        return self._replace(
            origin=self.origin.accepted(),
            of_landmarks=model.sources.adjustment_inflation * pair.given_keyframes,
            blur=model.blur(depth_m).covariance,
            unobserved_motion=model.covariance_at(T_world_left_before, added.unobserved_rb),
            kept_motion=ZERO,
            sums=sums_after_step(
                self.sums,
                position=position,
                displacement=position - T_world_left_before.translation,
                depth_m=depth_m,
                ambiguity=added.ambiguity,
                calibration=pair.calibration,
                model=model,
            ),
        )

    def kept(self, motion: FloatArray) -> PathErrors:
        """Return the errors of a pose that is kept during an unobserved motion."""
        return self._replace(kept_motion=motion)

    def adjusted(self, in_window: FloatArray) -> PathErrors:
        """Return the errors after an adjustment of the newest keyframe, which is the present pose."""
        return self._replace(in_window=in_window, of_landmarks=ZERO)

    def window_begun(self, position: FloatArray, *, first_image: FloatArray, in_window: FloatArray) -> PathErrors:
        """Return the errors at the start of a new window at a position.

        The first image has an error of its own, which displaces the new window and also the pose of the first pair.
        """
        before_window = self.of_map(position).covariance + self.this_pair + self.kept_motion + first_image
        return self._replace(
            origin=self.origin.window_begun(),
            before_window=LocatedCovariance(position, before_window),
            in_window=in_window,
            of_landmarks=ZERO,
            blur=first_image,
            unobserved_motion=ZERO,
            kept_motion=ZERO,
        )

    def reset(self, external: LocatedCovariance) -> PathErrors:
        """Return the errors after an external pose was applied to the last pose. Only the sums continue."""
        return PathErrors(Origin(external, sums=self.sums), sums=self.sums)

    def anchored(self, origin: Origin, *, at_last_pair: bool) -> PathErrors:
        """Return the errors since an external pose to which the map was anchored.

        If the external pose applies to the last accepted pair, the origin already includes the errors of this pair.
        """
        errors = self._replace(origin=origin)
        if at_last_pair:
            return errors._replace(of_landmarks=ZERO, blur=ZERO, unobserved_motion=ZERO)
        return errors


class PoseTerms(NamedTuple):
    """Terms of the covariance of a pose, each `(6, 6)`."""

    external: FloatArray  #: External pose to which the covariance is relative.
    keyframes: FloatArray  #: Keyframes and windows since the external pose.
    #: Errors of this pair that no other pose shares: landmarks, blur, stale parts of its image.
    this_pair: FloatArray
    kept_motion: FloatArray  #: Unobserved motion while the pose is kept.
    correlated: FloatArray  #: Errors that are correlated between steps: lens distortion, ambiguous motions.
    disparity: FloatArray  #: Errors common to all disparities, which scale the path.
    attitude: FloatArray  #: Bending of the path by the yaw and by the drift of the right camera.

    @property
    def total(self) -> FloatArray:
        """Covariance `(6, 6)` of the pose."""
        return sum(self[1:], start=self.external)


def pose_terms(
    errors: PathErrors, position: FloatArray, calibration: OnlineCalibration, model: RoverModel
) -> PoseTerms:
    """Return the terms of the covariance of the left camera at a position `(3,)`, m, in the world."""
    since_origin = errors.sums.since(errors.origin.sums)
    return PoseTerms(
        external=errors.origin.external.at(position),
        keyframes=errors.of_keyframes(position),
        this_pair=errors.this_pair,
        kept_motion=errors.kept_motion,
        correlated=since_origin.correlated_at(position),
        disparity=_disparity_term(since_origin, calibration, model.sources),
        attitude=_attitude_term(since_origin, calibration, model),
    )


def _disparity_term(sums: PathSums, calibration: OnlineCalibration, sources: ErrorSources) -> FloatArray:
    """Return the term `disparity`: effects of a constant disparity error, and of the yaw before its correction.

        disparity   = common_px^2 bias bias' + uncorrected uncorrected'   (position only)
        common_px^2 = disparity_px^2 + yaw_sigma_px^2 + (unsettled_yaw_ratio remaining_px)^2
        uncorrected = target_px bias - corrected

    `bias` and `corrected` are sums over the steps (`PathSums`), so that `uncorrected` is the sum of the displacements
    times the part of the yaw that was not corrected at the step.
    """
    unsettled_px = sources.unsettled_yaw_ratio * calibration.yaw.remaining_px
    common_px2 = sources.disparity_px**2 + calibration.yaw.sigma_px**2 + unsettled_px**2
    uncorrected = calibration.yaw.target_px * sums.bias - sums.corrected
    term = np.zeros((6, 6))
    term[:3, :3] = common_px2 * outer_square(sums.bias) + outer_square(uncorrected)
    return term


def _attitude_term(sums: PathSums, calibration: OnlineCalibration, model: RoverModel) -> FloatArray:
    """Return the term `attitude`: the yaw of the right camera, and errors of its drift corrections, bend the path.

        attitude = ((bent_attitude_ratio / f)^2 (yaw_sigma_px^2 + bent_px^2)
                    + (drift_attitude_ratio / f)^2 drift_px^2) I   (rotation only)

    `bent_px` is the yaw to be corrected, including that of maps that were discarded (`YawEstimate.bent_px`). `drift_px`
    is the sum of the absolute drift corrections.
    """
    sources = model.sources
    bent_px = sources.bent_attitude_ratio * np.hypot(calibration.yaw.sigma_px, calibration.yaw.bent_px)
    attitude_px = np.hypot(bent_px, sources.drift_attitude_ratio * sums.drift_px)
    rad2 = (attitude_px / model.fx) ** 2
    return diagonal_matrix((0.0, 0.0, 0.0, rad2, rad2, rad2))


def _positive_part(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of a matrix without its negative eigenvalues."""
    values, vectors = np.linalg.eigh(symmetric(matrix))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
