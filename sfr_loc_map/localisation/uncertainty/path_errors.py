"""Errors of the present pose, accumulated along the path: the state from which the covariance of the pose is computed.

Positions are `(3,)`, m, in the world. A covariance `(6, 6)` is that of position and rotation about fixed axes, for the
left camera in the world.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, length, read_only
from sfr_loc_map.geometry.transform import Transform, propagated_covariance
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.symmetric_matrices import positive_part
from sfr_loc_map.localisation.uncertainty.accepted_pair import AcceptedPair
from sfr_loc_map.localisation.uncertainty.correlated_error import NO_CORRELATED_ERROR, ZERO, CorrelatedError
from sfr_loc_map.localisation.uncertainty.inflation import AddedError
from sfr_loc_map.localisation.uncertainty.rover_model import RoverModel

ZERO_VECTOR = read_only(np.zeros(3))  #: Origin of the world, m, or a sum without steps.


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
    correlated: CorrelatedError = NO_CORRELATED_ERROR  #: Ambiguous motions, and bending of the path by the lens.
    turned: FloatArray = ZERO_VECTOR  #: Angle of the correlated errors times the position where it arose, rad m.

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
            self.correlated.since(earlier.correlated),
            self.turned - earlier.turned,
        )


def sums_after_step(
    before: PathSums,
    *,
    position: FloatArray,
    displacement: FloatArray,
    depth_m: float,
    ambiguity: CorrelatedError,
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
        ambiguity: Error if another motion is the true motion; zero if no finding requires it.
        calibration: The calibration after the step.
        model: Camera geometry and error sources.
    """
    m_per_px = displacement * depth_m / model.focal_baseline
    bending = CorrelatedError(0.0, model.lens_turn_per_m(calibration) * length(displacement))
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

    external: LocatedCovariance  #: Covariance of the external pose, for the present pose.
    #: Covariance of the external pose, for the pairs that are accepted next. If the external pose is later than the
    #: last accepted pair, the present pose is the external pose itself, but later poses continue from the last accepted
    #: pair (`path`). The errors of that pair relative to the external pose are then added here.
    external_of_next: LocatedCovariance
    of_map: LocatedCovariance = NOTHING  #: `PathErrors.of_map` at the external pose.
    sums: PathSums = PathSums()  #: Sums over the steps up to the external pose.

    @classmethod
    def of(cls, external: LocatedCovariance, sums: PathSums) -> Origin:
        """Return an external pose at which the map begins."""
        return cls(external, external, sums=sums)

    def accepted(self) -> Origin:
        """Return the external pose after a pair was accepted."""
        return self._replace(external=self.external_of_next)

    def window_begun(self) -> Origin:
        """Return the external pose after a window began at the present pose, from which later poses continue."""
        return self._replace(external_of_next=self.external)


@dataclass(frozen=True, slots=True, eq=False)
class PathErrors:
    """Errors of the present pose.

    The table shows how each event changes each component: `=` sets the component, `+` adds to the component, `0` sets
    the component to zero. Other components stay as they are.

    | component | `accepted` | `kept` | `adjusted` | `window_begun` | `reset` | `anchored` |
    |---|---|---|---|---|---|---|
    | `origin` | `external` = `external_of_next` | | | `external_of_next` = `external` | = new | = new |
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
    #: Covariance at the start of the present window: what earlier windows, and the motions between windows, have added
    #: since the map began.
    before_window: LocatedCovariance = NOTHING
    #: Covariance of the newest keyframe in its window, from the bundle adjustment, times `adjustment_inflation`.
    in_window: FloatArray = field(default_factory=lambda: ZERO)
    #: Covariance of the present pose given the keyframes (`given_keyframes`), times `adjustment_inflation`.
    of_landmarks: FloatArray = field(default_factory=lambda: ZERO)
    blur: FloatArray = field(default_factory=lambda: ZERO)  #: Covariance of errors of the whole image.
    #: Covariance of the motion to the present pose, if the findings require that this motion counts as unobserved.
    unobserved_motion: FloatArray = field(default_factory=lambda: ZERO)
    #: Covariance of the motion while the pose is kept. After an external pose, the motion counts from its stamp. The
    #: next step contains the whole motion since the last known pose instead (`PublishedPose.kept_s`).
    kept_motion: FloatArray = field(default_factory=lambda: ZERO)
    sums: PathSums = PathSums()  #: Sums over the steps up to the present pose.

    @property
    def this_pair(self) -> FloatArray:
        """Covariance `(6, 6)` of the errors of the present pose that no other pose shares: the term `this_pair`.

            this_pair = adjustment_inflation given_keyframes + blur + unobserved_motion

        `blur` is (Z_map blur_px / f)^2 in position and (blur_px / f)^2 in rotation (`RoverModel.blur`).
        """
        return self.of_landmarks + self.blur + self.unobserved_motion

    def of_map(self, position: FloatArray) -> LocatedCovariance:
        """Return the covariance that the map at a position has accumulated since it began.

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
        return positive_part(self.of_map(position).covariance - self.origin.of_map.at(position))

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
        return replace(
            self,
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
        return replace(self, kept_motion=motion)

    def adjusted(self, in_window: FloatArray) -> PathErrors:
        """Return the errors after an adjustment of the newest keyframe, which is the present pose."""
        return replace(self, in_window=in_window, of_landmarks=ZERO)

    def window_begun(self, position: FloatArray, *, first_image: FloatArray, in_window: FloatArray) -> PathErrors:
        """Return the errors at the start of a new window at a position.

        The first image has an error of its own, which displaces the new window and also the pose of the first pair.
        """
        before_window = self.of_map(position).covariance + self.this_pair + self.kept_motion + first_image
        return replace(
            self,
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
        return PathErrors(Origin.of(external, self.sums), sums=self.sums)

    def anchored(self, origin: Origin, *, at_last_pair: bool) -> PathErrors:
        """Return the errors since an external pose to which the map was anchored.

        If the external pose applies to the last accepted pair, the origin already includes the errors of this pair.
        """
        errors = replace(self, origin=origin)
        if at_last_pair:
            return replace(errors, of_landmarks=ZERO, blur=ZERO, unobserved_motion=ZERO)
        return errors
