"""The stages that compute and judge the pose of a pair. `Localiser` calls them in order, and skips the rest on refusal.

The stages take and return values; the clock, which they write to, only measures them. `Stages` holds their tools and
keeps no state between calls.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import NamedTuple

from sfr_loc_map.geometry.camera import Pose
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.localisation import guards
from sfr_loc_map.localisation.backend.online_calibration import OnlineCalibration
from sfr_loc_map.localisation.backend.sliding_window import LandmarkMap
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.findings import Finding, Verdict, decide
from sfr_loc_map.localisation.frontend.right_camera import RightOffset, pair_yaw
from sfr_loc_map.localisation.frontend.stereo_frame import StereoFrame
from sfr_loc_map.localisation.frontend.tracking import Tracker, Tracks
from sfr_loc_map.localisation.ground.rigid_motion import MotionTools
from sfr_loc_map.localisation.ground.selection import Ground
from sfr_loc_map.localisation.guards import ShearMean
from sfr_loc_map.localisation.keyframes import ImageMask, KeyframeMaker, KeyframeResult, max_corners
from sfr_loc_map.localisation.motion_model import LastPose, Prediction
from sfr_loc_map.localisation.relocalisation import RecoveryImages, Relocaliser


class StageClock:
    """Durations of the stages of one call, s, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time within the context to a stage."""
        start = perf_counter()
        try:
            yield
        finally:
            self.add(name, perf_counter() - start)

    def add(self, name: str, seconds: float) -> None:
        """Add a time that was measured elsewhere to a stage."""
        self.seconds[name] = self.seconds.get(name, 0.0) + seconds


class Candidate(NamedTuple):
    """A pair whose pose is to be judged."""

    frame: StereoFrame
    #: The map, in which landmarks that do not move with the ground are no longer tracked. Their earlier observations
    #: remain in the window (`SlidingWindow.deactivated`).
    landmark_map: LandmarkMap
    ground: Ground
    tracks: Tracks  #: Tracks of the ground with corrected right observations, and their pose.
    calibration: OnlineCalibration  #: The calibration, updated by the pair.
    shear_mean: ShearMean  #: The running mean, updated by the pair.
    shear_chi2: float = 0.0  #: Squared shear of the rows of this pair, divided by its variance, per degree of freedom.


class FinalPose(NamedTuple):
    """The final pose of an accepted pair."""

    tracks: Tracks  #: The judged tracks. For a keyframe, tracks of all landmarks unless a guard refuses their pose.
    is_keyframe: bool  #: Whether the pair becomes a keyframe.
    is_recovery_image: bool  #: Whether the pair may serve to recover lost tracking.


class Stages:
    """The stages that process a pair, and the tools of the localiser, created for one rig and one configuration."""

    def __init__(self, rig: StereoRig, config: LocalisationConfig) -> None:
        """Create the tools. ConfigError if a mask cannot be read or its size is not the rig's."""
        self._config = config
        self._camera = rig.camera
        self._shape = (rig.height, rig.width)
        self._max_corners = max_corners(rig, config)
        self.tracker = Tracker(config.min_tracked, rig.camera)
        self.relocaliser = Relocaliser(self.tracker, config, rig.camera, self._max_corners)
        self.keyframes = KeyframeMaker(rig, config)
        self.motion_tools = MotionTools(self.tracker, self.relocaliser, rig.camera, self._shape, config.min_tracked)

    # ---- tracking

    def track(
        self,
        frame: StereoFrame,
        landmark_map: LandmarkMap,
        prediction: Prediction,
        recovery: RecoveryImages,
        clock: StageClock,
    ) -> Tracks:
        """Track the landmarks of the map; relocalise if the pose is not trusted."""
        landmarks = landmark_map.tracked
        with clock.stage("align"):
            coarse = self.tracker.align(frame.left, landmark_map.aligned, prediction.guesses)
        with clock.stage("refine"):
            tracks = self.tracker.refine(frame, landmarks, coarse, prediction.offset)
        if tracks.is_trusted:
            return tracks
        with clock.stage("relocate"):
            found = self.relocaliser.relocalise(frame, landmarks, recovery, prediction.offset)
        return found or tracks

    def correct_right_camera(
        self,
        frame: StereoFrame,
        landmark_map: LandmarkMap,
        ground: Ground,
        calibration: OnlineCalibration,
        shear_mean: ShearMean,
    ) -> Candidate:
        """Estimate the yaw of the right camera, and correct the right observations for a drift of the right camera.

        Return the candidate, in whose map the landmarks that do not move with the ground are no longer tracked. Tracks
        that are not trusted remain unchanged, because stage 8 refuses them.
        """
        tracks = ground.tracks
        landmark_map = landmark_map.deactivated(ground.not_ground)
        uncorrected = Candidate(frame, landmark_map, ground, tracks, calibration, shear_mean)
        if not tracks.is_trusted:
            return uncorrected
        lens_px = calibration.lens.likely_px
        landmarks = tracks.landmarks.estimates
        yaw = pair_yaw(tracks.pose, landmarks, tracks.observed, self._camera, self._shape, lens_px)
        if yaw is None:
            return uncorrected
        calibration, drift_px = calibration.with_pair(yaw)
        if drift_px != 0.0:
            observations = tracks.observations.copy()
            observations[:, 2:] -= RightOffset(yaw_px=drift_px).at(observations[:, 2:], self._camera)
            observed = tracks.observed._replace(uv=observations)
            tracks = self.tracker.solve(tracks.landmarks, observed, tracks.pose)
        return uncorrected._replace(
            tracks=tracks,
            calibration=calibration,
            shear_mean=shear_mean.with_pair(yaw.shear_chi2),
            shear_chi2=yaw.shear_chi2,
        )

    # ---- verdict and final pose

    def judge(self, last: LastPose, gap_keyframes: int, candidate: Candidate, findings: frozenset[Finding]) -> Verdict:
        """Judge a pose by the findings of the earlier stages, and by the guards that examine a pose.

        Args:
            last: Last known pose.
            gap_keyframes: `State.gap_keyframes`.
            candidate: Pair to be judged.
            findings: Findings of the earlier stages.
        """
        frame = candidate.frame
        tracks = candidate.tracks
        findings |= self._refusals_of_pose(last, frame, tracks)
        verdict = decide(findings)
        if verdict.refuses:  # the other guards require a valid pose
            return verdict
        findings |= guards.check_sides(frame, tracks, self.tracker, candidate.calibration.offset)
        findings |= guards.check_gap(gap_keyframes)
        findings |= guards.check_calibration(candidate.calibration)
        findings |= guards.check_shear(candidate.shear_chi2, candidate.shear_mean)
        return decide(findings)

    def _refusals_of_pose(self, last: LastPose, frame: StereoFrame, tracks: Tracks) -> frozenset[Finding]:
        """Return the findings of the fast guards that refuse poses; they are repeated for the pose of a keyframe."""
        of_pose = guards.check_pose(tracks, last, frame.stamp_ns, self._config.motion)
        return guards.check_tracks(frame, tracks) | of_pose

    def complete(self, last: LastPose, candidate: Candidate, verdict: Verdict, clock: StageClock) -> FinalPose:
        """Decide what an accepted pair is used for, and solve for the pose of a keyframe from all landmarks.

        Later pairs are compared with the left image of a recovery image, which must therefore show enough landmarks.
        Only a recovery image may become a keyframe.

        Only the errors of keyframes accumulate. Other poses are therefore estimated from fewer landmarks to save time.
        Findings about the images hold for the pose of all landmarks as well, so that only the pose is checked again. If
        that pose is refused, the judged tracks are used.
        """
        tracks = candidate.tracks
        is_recovery_image = verdict.can_be_reference and tracks.left_inlier_count >= self._config.min_tracked
        if not (is_recovery_image and self.keyframes.is_needed(tracks, candidate.landmark_map)):
            return FinalPose(tracks, is_keyframe=False, is_recovery_image=is_recovery_image)
        with clock.stage("refine"):
            of_all = self.with_all_landmarks(candidate)
            if not self._refusals_of_pose(last, candidate.frame, of_all):
                tracks = of_all
        return FinalPose(tracks, is_keyframe=True, is_recovery_image=True)

    def with_all_landmarks(self, candidate: Candidate) -> Tracks:
        """Track the remaining landmarks, and estimate the pose from all landmarks."""
        tracks = candidate.tracks
        landmark_map = candidate.landmark_map
        rest = landmark_map.rest_of(tracks.landmarks)
        if not len(rest.rows):
            return tracks
        offset = candidate.calibration.offset
        return self.tracker.complete(candidate.frame, tracks, landmark_map.landmarks, rest, offset)

    # ---- a new window

    def begin_window(
        self, frame: StereoFrame, pose: Pose, calibration: OnlineCalibration, ground_mask: ImageMask | None
    ) -> tuple[KeyframeResult, frozenset[Finding]]:
        """Begin a window with a pair at a pose, and apply the guards for its landmarks.

        If the window has few landmarks, those of the swapped images show whether the order is the cause.
        """
        window = self.keyframes.begin_window(frame, pose, calibration, ground_mask)
        landmarks = window.landmark_map.landmarks
        min_tracked = self._config.min_tracked
        findings = guards.check_landmarks(frame, landmarks, min_tracked)
        if len(landmarks.rows) < max(min_tracked, guards.ORDER_TESTED_RATIO * self._max_corners):
            count_if_swapped = self.keyframes.landmark_count(frame.swapped(), pose, calibration, ground_mask)
            findings |= guards.check_order(landmarks, count_if_swapped, min_tracked)
        return window, findings
