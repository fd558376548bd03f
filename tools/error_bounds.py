"""Lower bounds of the errors of the localiser and the mapper that follow from image noise.

The bound of poses is the Cramer-Rao bound. The information about a patch position in an image is the structure tensor
of the patch over the noise variance (Robinson and Milanfar 2004). All poses and landmarks of a sub-trajectory are
estimated jointly. The bound of disparities is the Wiener error of a Gaussian field that has the spectrum of the true
disparities in a part of the image, with the information of the gradients along rows.

    python tools/error_bounds.py drive SOURCE [--distance 5]
    python tools/error_bounds.py map SOURCE [--contrast 0.6 --noise 6.5]

Both commands print the smallest possible error of an unbiased estimator on these images, and the error of ours.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from sfr_loc_map.geometry.robust_statistics import MAD_TO_SIGMA
from sfr_loc_map.geometry.stereo import StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import drive_of, panorama_of
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.findings import Verdict
from sfr_loc_map.localisation.frontend.patch import HALF
from sfr_loc_map.localisation.frontend.tracking import Tracks
from sfr_loc_map.localisation.localiser import Localiser
from sfr_loc_map.localisation.state import Candidate, Outcome, State
from sfr_loc_map.mapping.disparity.refinement.variational_refinement import RefinedDisparity
from sfr_loc_map.runs.drive_start import start_pose
from train_jump_network import refined_scene

EVERY = 10
"""Number of pairs between the starts of sub-trajectories for the bound."""
TILE = 64
"""Side of an image part, px, in which the disparities are assumed to be a stationary field."""


def noise_of(disparity: RefinedDisparity) -> float:
    """Return the noise of one image, grey levels, from residuals, which have the noise of two images."""
    return disparity.noise_grey / np.sqrt(2.0)


def gradients(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the grey-level gradients along u and v (central differences, float64)."""
    along_v, along_u = np.gradient(image.astype(float))
    return along_u, along_v


def structure(image: np.ndarray, noise: float) -> np.ndarray:
    """Return the structure tensor of patches `(H, W, 2, 2)` without the contribution of noise."""
    u, v = gradients(image)
    side = 2 * HALF + 1
    uu, uv, vv = (cv2.boxFilter(x, -1, (side, side), normalize=False) for x in (u * u, u * v, v * v))
    of_noise = side * side * noise * noise / 2.0
    uu, vv = np.maximum(uu - of_noise, 1e-6), np.maximum(vv - of_noise, 1e-6)
    uv = np.clip(uv, -0.99 * np.sqrt(uu * vv), 0.99 * np.sqrt(uu * vv))
    return np.stack((np.stack((uu, uv), -1), np.stack((uv, vv), -1)), -2)


@dataclass(frozen=True)
class Sight:
    """The pose of a pair, and N landmarks: number, point, information of the image position, cameras that see it."""

    T_world_left: Transform
    number: np.ndarray
    points: np.ndarray
    information: np.ndarray
    seen: np.ndarray


class RecordingLocaliser(Localiser):
    """Stores the last accepted tracks."""

    accepted: Tracks | None = None

    def _accept(
        self, state: State, candidate: Candidate, verdict: Verdict, *, is_reference: bool, is_keyframe: bool
    ) -> Outcome:
        self.accepted = candidate.tracks
        return super()._accept(state, candidate, verdict, is_reference=is_reference, is_keyframe=is_keyframe)


def sights(source: Path) -> tuple[list[Sight], list[Transform], StereoRig]:
    """Return the observations of each pair of a drive, the true poses of the left camera, and the rig."""
    drive = drive_of(open_source(source))
    rig, truth = drive.rig, drive.ground_truth
    pairs = list(drive.pairs())
    noise = float(np.median([noise_of(refined_scene(pair, rig)[1]) for pair in pairs[:: max(len(pairs) // 8, 1)]]))
    print(f"noise of an image: {noise:.2f} grey levels")
    localiser = RecordingLocaliser(rig, LocalisationConfig(), start_pose(drive, "truth"))
    found, true = [], []
    for pair in pairs:
        estimate = localiser.process(pair)
        keyframe = localiser._pending
        landmark_map = localiser._state.landmark_map if keyframe is None else keyframe.result().landmark_map
        if landmark_map is not None and (keyframe is not None or not true):  # the first pair is a keyframe
            landmarks = landmark_map.landmarks
            observed = landmarks.last_seen
        elif localiser.accepted is not None:
            landmarks = localiser.accepted.landmarks
            observed = localiser.accepted.observations
        else:
            raise SystemExit(f"pair {pair.stamp_ns} was not tracked: the bound requires a drive without lost pairs")
        rows = np.isfinite(observed[:, 0]) & np.isfinite(landmarks.points).all(axis=1)
        uv = np.rint(observed[rows, :2]).astype(int)
        information = structure(pair.left, noise)[uv[:, 1], uv[:, 0]] / noise**2
        seen = np.isfinite(observed[rows][:, ::2])
        pose = estimate.T_ds_rb @ rig.T_rb_left
        found.append(Sight(pose, landmarks.patches.rows[rows], landmarks.points[rows], information, seen))
        true.append(truth.pose(int(np.argmin(np.abs(truth.stamps_ns - pair.stamp_ns)))) @ rig.T_rb_left)
    return found, true, rig


def add_pair(sight: Sight, rig: StereoRig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the information of a pair about pose `(N, 6, 6)`, pose and point `(N, 6, 3)`, and point `(N, 3, 3)`.

    The perturbation of the pose is a rotation and then a translation of the camera, both in camera axes.
    """
    rotation = sight.T_world_left.rotation
    at = (sight.points - sight.T_world_left.translation) @ rotation
    total = np.zeros((len(at), 9, 9))
    for camera, shift in enumerate((0.0, rig.baseline_m)):
        x, y, z = (at - (shift, 0.0, 0.0)).T
        zero = np.zeros_like(z)
        project = rig.fx * np.stack((np.stack((1 / z, zero, -x / z**2), -1), np.stack((zero, 1 / z, -y / z**2), -1)), 1)
        cross = np.zeros((len(at), 3, 3))  # d(R(-w) p) / dw = [p]x
        cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -at[:, 2], at[:, 1], -at[:, 0]
        cross -= cross.transpose(0, 2, 1)
        minus = np.broadcast_to(-np.eye(3), cross.shape)
        jacobian = project @ np.concatenate((cross, minus, np.broadcast_to(rotation.T, cross.shape)), axis=2)
        weight = sight.information * sight.seen[:, camera, None, None]
        total += jacobian.transpose(0, 2, 1) @ weight @ jacobian
    return total[:, :6, :6], total[:, :6, 6:], total[:, 6:, 6:]


def last_covariance(part: list[Sight], rig: StereoRig) -> np.ndarray:
    """Return the bound of the covariance `(6, 6)` of the last pose relative to the first, in camera axes."""
    size = 6 * len(part)
    total = np.zeros((size, size))
    numbers = np.unique(np.concatenate([s.number for s in part]))
    of_point = np.zeros((len(numbers), 3, 3))
    shared: list[list[tuple[int, np.ndarray]]] = [[] for _ in numbers]
    for k, sight in enumerate(part):
        pose, both, point = add_pair(sight, rig)
        total[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] += pose.sum(axis=0)
        rows = np.searchsorted(numbers, sight.number)
        of_point[rows] += point
        for row, block in zip(rows, both, strict=True):
            shared[row].append((k, block))
    for information, blocks in zip(of_point, shared, strict=True):
        at = np.concatenate([np.arange(6 * k, 6 * k + 6) for k, _ in blocks])
        both = np.concatenate([block for _, block in blocks])
        total[np.ix_(at, at)] -= both @ np.linalg.pinv(information) @ both.T
    covariance = np.linalg.inv(total[6:, 6:])
    return covariance[-6:, -6:]


def mean_3_sigma(errors: np.ndarray) -> float:
    """Return mean + 3 sigma of error norms."""
    return float(errors.mean() + 3.0 * errors.std())


def bound_drive(source: Path, distance_m: float) -> None:
    """Print the bound and the actual error of poses over sub-trajectories."""
    found, true, rig = sights(source)
    path = np.cumsum([0.0] + [float(np.linalg.norm(b.translation - a.translation)) for a, b in pairwise(true)])
    random = np.random.default_rng(0)
    bounds, errors, starts = [], [], 0
    for start in range(len(found)):
        end = int(np.searchsorted(path, path[start] + distance_m))
        if end >= len(found):
            break
        estimated = found[start].T_world_left.inverse() @ found[end].T_world_left
        error = (true[start].inverse() @ true[end]).inverse() @ estimated
        errors.append(
            (np.linalg.norm(error.translation) * 1e3, np.degrees(np.linalg.norm(cv2.Rodrigues(error.rotation)[0])))
        )
        if start % EVERY == 0:
            starts += 1
            drawn = random.multivariate_normal(np.zeros(6), last_covariance(found[start : end + 1], rig), 1000)
            drawn_mm, drawn_rad = np.linalg.norm(drawn[:, 3:], axis=1) * 1e3, np.linalg.norm(drawn[:, :3], axis=1)
            bounds.append(np.column_stack((drawn_mm, np.degrees(drawn_rad))))
    bound, error = np.concatenate(bounds), np.array(errors)
    sigma = np.concatenate([np.linalg.inv(s.information)[:, [0, 1], [0, 1]] for s in found])
    print(
        f"position of a patch, median sigma px: columns {np.sqrt(np.median(sigma[:, 0])):.4f}, "
        f"rows {np.sqrt(np.median(sigma[:, 1])):.4f}; {np.mean([len(s.number) for s in found]):.0f} landmarks per pair"
    )
    print(f"over {distance_m} m: bound of {starts}, error of {len(errors)} sub-trajectories")
    for column, name in enumerate(("position mm", "attitude deg")):
        b, e = bound[:, column], error[:, column]
        print(
            f"{name}: root mean square {np.sqrt(np.mean(b**2)):.4f}, {np.sqrt(np.mean(e**2)):.4f}; "
            f"mean + 3 sigma {mean_3_sigma(b):.4f}, {mean_3_sigma(e):.4f}"
        )


def changed(pair: StereoPair, contrast: float, noise: float, random: np.random.Generator) -> StereoPair:
    """Return a pair with a scaled contrast and additional noise, grey levels."""
    images = (
        x.mean() + contrast * (x - x.mean()) + random.normal(0.0, noise, x.shape) for x in (pair.left, pair.right)
    )
    left, right = (np.clip(np.rint(x), 0, 255).astype(np.uint8) for x in images)
    return StereoPair(pair.stamp_ns, left, right)


def bound_map(source: Path, contrast: float, more_noise: float) -> None:
    """Print the bound and the actual error of disparities."""
    panorama, random = panorama_of(open_source(source)), np.random.default_rng(0)
    rig = panorama.rig
    window = np.outer(np.hanning(TILE), np.hanning(TILE))
    rows, bounds, errors = [], [], []
    v, u = np.mgrid[:TILE, :TILE] / TILE - 0.5
    plane = np.column_stack((np.ones(TILE * TILE), u.ravel(), v.ravel()))
    for posed in panorama.pairs():
        depth = (posed.T_lm_navsb @ rig.T_sb_left).inverse().apply(posed.truth)[..., 2]
        truth = rig.fx * rig.baseline_m / np.where((depth > 0.0) & (depth < 40.0), depth, np.nan)
        pair = changed(posed.pair, contrast, more_noise, random)
        _, disparity = refined_scene(pair, rig)
        noise = noise_of(disparity)
        along_u, _ = gradients(pair.left)
        for top in range(0, rig.height - TILE + 1, TILE // 2):
            for left in range(0, rig.width - TILE + 1, TILE // 2):
                tile = np.s_[top : top + TILE, left : left + TILE]
                field = truth[tile]
                if not np.isfinite(field).all():
                    continue
                power = max(float(np.mean(along_u[tile] ** 2)) - noise**2 / 2.0, 1e-3)
                information = power / (2.0 * noise**2)
                left_over = field - (plane @ np.linalg.lstsq(plane, field.ravel(), rcond=None)[0]).reshape(TILE, TILE)
                spectrum = np.abs(np.fft.fft2(left_over * window)) ** 2 / np.sum(window**2)
                # Wiener: the error of a component of power S, observed with information I per pixel, is S / (1 + S I);
                # the plane adds three unknowns
                variance = np.mean(spectrum / (1.0 + spectrum * information)) + 3.0 / (information * TILE * TILE)
                bounds.append(np.sqrt(variance))
                errors.append((disparity.px - truth)[tile].ravel())
                rows.append(np.abs(left_over).max() < 1.0)
        print(f"noise of an image: {noise:.2f} grey levels")
    bound, smooth = np.array(bounds), np.array(rows)
    for name, chosen in (("all", np.ones(len(bound), bool)), ("within 1 px of a plane", smooth)):
        drawn = random.normal(size=(int(chosen.sum()), 64)) * bound[chosen][:, None]
        error = np.concatenate([e for e, c in zip(errors, chosen, strict=True) if c])
        print(
            f"{name}: {chosen.sum()} parts; sigma px: bound {MAD_TO_SIGMA * np.median(np.abs(drawn)):.4f}, "
            f"error {MAD_TO_SIGMA * np.median(np.abs(error - np.median(error))):.4f}"
        )


def main() -> None:
    """Print the bounds of a drive or of a map."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("drive", "map"))
    parser.add_argument("source", type=Path)
    parser.add_argument("--distance", type=float, default=5.0)
    parser.add_argument("--contrast", type=float, default=1.0)
    parser.add_argument("--noise", type=float, default=0.0)
    given = parser.parse_args()
    if given.what == "drive":
        bound_drive(given.source, given.distance)
    else:
        bound_map(given.source, given.contrast, given.noise)


if __name__ == "__main__":
    main()
