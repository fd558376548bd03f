"""The window of keyframes: their poses, the landmarks they host, what was seen of them, and the prior."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.localisation.backend.bundle_adjustment import Prior, adjust, linearise
from sfr_loc_map.localisation.frontend.image_pyramid import LEVELS, Pyramid
from sfr_loc_map.localisation.frontend.patch_tracking import SIDE, cut_patches

COARSE_HALF = 3
SIDES = (SIDE, *[2 * COARSE_HALF + 1] * (LEVELS - 1))
"""Sides of the patches at each level."""
START_VARIANCE = 1e-10
"""Variance of the first pose (m^2, rad^2): it is given, not estimated."""


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """The landmarks that are looked for, as arrays for the machine code; fields as in `Window`.

    Attributes:
        index: `(M,)` their places in the window.
        host_rotations: `(M, 3, 3)` host cameras to world.
        host_positions: `(M, 3)` metres.
        uv: `(M, 2)` host pixels.
        rays: `(M, 3)` host rays of the estimated host pixels.
        rho: `(M,)` 1/m.
        slopes: `(M, 2)` 1/m a pixel.
        covariance: `(M, 3, 3)`.
        patches: One array `(M, 3, S * S)` a level.
        last_seen: `(M, 4)` where the newest keyframe saw them.
    """

    index: NDArray[np.intp]
    host_rotations: FloatArray
    host_positions: FloatArray
    uv: FloatArray
    rays: FloatArray
    rho: FloatArray
    slopes: FloatArray
    covariance: FloatArray
    patches: list[NDArray[np.float32]]
    last_seen: FloatArray

    def __len__(self) -> int:
        """Return their number."""
        return len(self.index)

    @property
    def points(self) -> FloatArray:
        """Their places `(M, 3)`, metres, world; NaN where too far to have one."""
        rho = np.where(self.rho > 1e-6, self.rho, np.nan)
        return np.asarray(np.einsum("nij,nj->ni", self.host_rotations, self.rays) / rho[:, None] + self.host_positions)


class Window:
    """Keyframes adjusted together, oldest first, and their landmarks.

    Attributes:
        rotations: `(K, 3, 3)` left cameras to world.
        positions: `(K, 3)` metres, world.
        host: `(N,)` int64 keyframe of each landmark.
        uv: `(N, 2)` host pixel of its patch, whole pixels.
        uvrho: `(N, 3)` its estimated host pixel and inverse depth (1/m).
        slopes: `(N, 2)` change of the inverse depth a pixel, of its local plane.
        covariance: `(N, 3, 3)` of uvrho given the poses.
        alive: `(N,)` whether it is still looked for.
        patches: For each keyframe the patches of the landmarks that it hosts, one array `(n, 3, S * S)` a level of the
            pyramid: what is large is neither copied when landmarks come nor when they go.
        observed: `(N, K, 4)` where it was seen: u, v left, u, v right; NaN where not.
        variance: `(N, K, 2, 3)` uu, uv, vv of these, px^2.
        pose_covariance: `(6 K, 6 K)` of all poses, position and rotation about the world's axes.
        right_offset: By how many pixels right pictures lie too far right, and the variance of that, px^2.
    """

    def __init__(self, camera: FloatArray, baseline_m: float, size: int) -> None:
        """Start empty; camera is fx, fy, cx, cy, size the most keyframes."""
        self._camera, self._baseline, self._size = camera, baseline_m, size
        self.rotations, self.positions = np.zeros((0, 3, 3)), np.zeros((0, 3))
        self.host, self.alive = np.zeros(0, np.int64), np.zeros(0, np.bool_)
        self.uv, self.uvrho, self.slopes = np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 2))
        self.covariance = np.zeros((0, 3, 3))
        self.patches: list[list[NDArray[np.float32]]] = []
        self.observed, self.variance = np.zeros((0, 0, 4)), np.zeros((0, 0, 2, 3))
        self.pose_covariance = np.zeros((0, 0))
        self.right_offset = (0.0, np.inf)
        self._prior = Prior(np.zeros((0, 0)), np.zeros(0), self.rotations, self.positions)

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return len(self.rotations)

    @property
    def last_covariance(self) -> FloatArray:
        """Covariance `(6, 6)` of the newest keyframe's pose."""
        return self.pose_covariance[-6:, -6:]

    def landmarks(self) -> Landmarks:
        """Return the landmarks that are looked for."""
        which = np.flatnonzero(self.alive)
        fx, fy, cx, cy = self._camera
        u, v = self.uvrho[which, 0], self.uvrho[which, 1]
        return Landmarks(
            which,
            self.rotations[self.host[which]],
            self.positions[self.host[which]],
            self.uv[which],
            np.column_stack(((u - cx) / fx, (v - cy) / fy, np.ones(len(which)))),
            self.uvrho[which, 2].copy(),
            self.slopes[which],
            self.covariance[which],
            [self._living(level) for level in range(LEVELS)],
            self.observed[which, -1],
        )

    def add_keyframe(
        self,
        rotation: FloatArray,
        position: FloatArray,
        seen: NDArray[np.intp],
        observed: FloatArray,
        variance: FloatArray,
    ) -> None:
        """Append a keyframe with what it sees of the landmarks; the oldest leaves a full window.

        Args:
            rotation: `(3, 3)` camera to world.
            position: `(3,)` metres.
            seen: `(M,)` landmarks.
            observed: `(M, 4)`.
            variance: `(M, 2, 3)`.
        """
        count, window = self.observed.shape[:2]
        self.observed = np.concatenate((self.observed, np.full((count, 1, 4), np.nan)), axis=1)
        self.variance = np.concatenate((self.variance, np.ones((count, 1, 2, 3))), axis=1)
        self.observed[seen, window], self.variance[seen, window] = observed, variance
        self.rotations = np.concatenate((self.rotations, rotation[None]))
        self.positions = np.concatenate((self.positions, position[None]))
        self.patches.append([np.zeros((0, 3, side * side), np.float32) for side in SIDES])
        self._prior = Prior(
            np.pad(self._prior.h, (0, 6)),
            np.pad(self._prior.g, (0, 6)),
            np.concatenate((self._prior.rotations, rotation[None])),
            np.concatenate((self._prior.positions, position[None])),
        )
        if len(self) == 1:
            self.set_prior(np.full(6, START_VARIANCE))
        if len(self) > self._size:
            self._marginalise_oldest()

    def set_prior(self, variance: FloatArray) -> None:
        """Let the only keyframe be known as well as its `(6,)` variances say."""
        self._prior = replace(self._prior, h=np.diag(1.0 / variance))

    def add_landmarks(
        self,
        left: Pyramid,
        uv: FloatArray,
        rho: FloatArray,
        slopes: FloatArray,
        patches: NDArray[np.float32],
        observed: FloatArray,
        variance: FloatArray,
    ) -> None:
        """Add the landmarks hosted by the newest keyframe, once for each.

        Args:
            left: Left pyramid of the keyframe.
            uv: `(M, 2)` host pixels.
            rho: `(M,)` 1/m.
            slopes: `(M, 2)` 1/m a pixel.
            patches: `(M, 3, S * S)` at full size.
            observed: `(M, 4)` in the keyframe itself.
            variance: `(M, 2, 3)`.
        """
        count, window = len(uv), len(self)
        self.host = np.concatenate((self.host, np.full(count, window - 1, np.int64)))
        self.alive = np.concatenate((self.alive, np.ones(count, np.bool_)))
        self.uv = np.concatenate((self.uv, uv))
        self.uvrho = np.concatenate((self.uvrho, np.column_stack((uv, rho))))
        self.slopes = np.concatenate((self.slopes, slopes))
        self.covariance = np.concatenate((self.covariance, np.zeros((count, 3, 3))))
        self.patches[-1] = [patches, *(_coarse_patches(left, uv, level) for level in range(1, LEVELS))]
        all_observed, all_variance = np.full((count, window, 4), np.nan), np.ones((count, window, 2, 3))
        all_observed[:, -1], all_variance[:, -1] = observed, variance
        self.observed = np.concatenate((self.observed, all_observed))
        self.variance = np.concatenate((self.variance, all_variance))

    def adjust(self, rounds: int) -> None:
        """Adjust all keyframes and landmarks together."""
        result = adjust(*self._system(), self._prior, rounds)
        self.rotations, self.positions = result.rotations, result.positions
        self.uvrho, self.covariance = result.uvrho, result.covariance
        self.pose_covariance = result.pose_covariance
        self.right_offset = result.right_offset

    def move_right_pictures(self, columns: float) -> None:
        """Move all that was seen in right pictures as if the camera were turned, by so many pixels in the middle."""
        x = (self.observed[:, :, 2] - self._camera[2]) / self._camera[0]
        self.observed[:, :, 2] += columns * (1.0 + x * x)

    def _system(
        self,
    ) -> tuple[FloatArray, FloatArray, NDArray[np.int64], FloatArray, FloatArray, FloatArray, FloatArray, float]:
        poses = (self.rotations, self.positions)
        return *poses, self.host, self.uvrho, self.observed, self.variance, self._camera, self._baseline

    def _living(self, level: int) -> NDArray[np.float32]:
        ends = np.cumsum([len(hosted[level]) for hosted in self.patches])[:-1]
        living = np.split(self.alive, ends)
        return np.concatenate([hosted[level][which] for hosted, which in zip(self.patches, living, strict=True)])

    def _marginalise_oldest(self) -> None:
        """Turn what the oldest keyframe and its landmarks say of the others into the prior."""
        h, g, *_ = linearise(*self._system(), 0)
        h = h[:-1, :-1] + self._prior.h
        g = g[:-1] + self._prior.right_side(self.rotations, self.positions)
        gain = np.linalg.solve(h[:6, :6], h[:6, 6:]).T
        rest = h[6:, 6:] - gain @ h[:6, 6:]
        self.rotations, self.positions = self.rotations[1:].copy(), self.positions[1:].copy()
        self._prior = Prior(0.5 * (rest + rest.T), g[6:] - gain @ g[:6], self.rotations, self.positions)
        keep = self.host > 0
        self.host = self.host[keep] - 1
        for name in ("alive", "uv", "uvrho", "slopes", "covariance", "variance", "observed"):
            setattr(self, name, getattr(self, name)[keep])
        self.observed, self.variance = self.observed[:, 1:].copy(), self.variance[:, 1:].copy()
        del self.patches[0]


def _coarse_patches(left: Pyramid, uv: FloatArray, level: int) -> NDArray[np.float32]:
    image = left.levels[level]
    height, width = image.shape
    margin = COARSE_HALF + 2
    small = (uv + 0.5) / 2.0**level - 0.5
    inside = np.all((small >= margin) & (small <= [width - 1 - margin, height - 1 - margin]), axis=1)
    cut = cut_patches(image, np.clip(small, margin, [width - 1 - margin, height - 1 - margin]), COARSE_HALF)
    cut[~inside] = 0.0  # no texture: never in view
    return cut
