"""Active landmarks: the landmarks of the sliding window that are still tracked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask
from sfr_loc_map.localisation.frontend.patch import HALF, SIDE, Templates, cut_patches, templates_of
from sfr_loc_map.localisation.frontend.plane_warp import LocalPlanes
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates
from sfr_loc_map.localisation.frontend.pyramid import LEVELS, ImageLevel

BORDER = HALF + 4  #: Width of the image border without landmarks, px. A patch and its gradients must fit.
COARSE_HALF = 3
"""Half width of a patch on the coarser pyramid levels, px of the level. On these levels, a patch covers at least as
much of the image as at full size."""
MIN_INVERSE_DEPTH = 1e-6
"""Inverse depth, 1/m (1000 km), up to which a landmark is treated as being at infinity. The bound prevents a division
by zero."""
MAX_DEPTH_M = 1000.0
"""Maximum median depth, m. Motions are divided by the median depth, and errors grow with it. Beyond 1 km, landmarks do
not show the translation of a rover."""
ALIGNED_LANDMARKS = 200
"""Maximum number of landmarks in the alignment of a pose. The pose from 300 landmarks differed by 0.02 px from the pose
from all landmarks (measurements/localiser_trials.md)."""


class HostPatches(NamedTuple):
    """Patches of the n landmarks that a keyframe hosts."""

    uv: FloatArray  #: `(n, 2)` centres of the patches, whole pixels.
    fine: Templates  #: Templates at full size; read only.
    coarse: tuple[ImageLevel, ...]  #: Coarser levels of the keyframe's pyramid, for the alignment.


NO_PATCHES = HostPatches(
    np.zeros((0, 2)),
    Templates(np.zeros((0, 3, SIDE * SIDE), np.float32), np.zeros((0, 6))),
    (ImageLevel(np.zeros((1, 1), np.float32), 1.0),) * (LEVELS - 1),
)
"""Patches of a keyframe that hosts no landmark."""


class LandmarkTemplates:
    """Templates of M landmarks by pyramid level, taken from their host keyframes at the first access to a level.

    `rows` `(M,)` are the increasing rows of the landmarks in the sliding window, whose arrays hold the landmarks of one
    host after those of another (`Landmarks.rows`).
    """

    def __init__(self, hosted: tuple[HostPatches, ...], rows: NDArray[np.intp]) -> None:
        self.hosted = hosted
        self.rows = rows
        self._by_level: dict[int, Templates] = {}

    def at(self, level: int) -> Templates:
        """Return the templates of a level."""
        if level not in self._by_level:
            self._by_level[level] = self._fine() if level == 0 else self._coarse(level)
        return self._by_level[level]

    def hosts(self, level: int) -> Iterator[tuple[FloatImage, slice]]:
        """Yield the image of each host at a coarser level, with the slice of the landmarks that it hosts."""
        for host, _, hosted in self._by_host():
            if hosted.start < hosted.stop:
                yield host.coarse[level - 1].image, hosted

    def _by_host(self) -> Iterator[tuple[HostPatches, NDArray[np.intp], slice]]:
        """Yield each host, the rows of its landmarks in its `HostPatches`, and their slice of the M landmarks."""
        ends = np.cumsum([0, *(len(host.uv) for host in self.hosted)])
        bounds = np.searchsorted(self.rows, ends).tolist()
        for host, end, first, last in zip(self.hosted, ends, bounds, bounds[1:], strict=False):
            hosted = slice(first, last)
            yield host, self.rows[hosted] - end, hosted

    def _fine(self) -> Templates:
        """Copy the templates at full size."""
        count = len(self.rows)
        values = np.empty((count, *self.hosted[-1].fine.values.shape[1:]), np.float32)
        moments = np.empty((count, 6))
        for host, rows, hosted in self._by_host():
            # mode "raise" would copy twice
            np.take(host.fine.values, rows, axis=0, out=values[hosted], mode="clip")
            moments[hosted] = host.fine.moments[rows]
        return Templates(values, moments)

    def _coarse(self, level: int) -> Templates:
        """Cut the templates of a coarser level. A patch that leaves the image is set to 0 and is then not aligned."""
        margin = COARSE_HALF + 2
        parts = []
        for host, rows, _ in self._by_host():
            image = host.coarse[level - 1].image
            uv = (host.uv[rows] + 0.5) / 2.0**level - 0.5
            last = np.array(image.shape[::-1]) - 1 - margin
            is_inside = np.all((uv >= margin) & (uv <= last), axis=1)
            patches = np.zeros((len(uv), 3, (2 * COARSE_HALF + 1) ** 2), np.float32)
            patches[is_inside] = cut_patches(image, uv[is_inside], COARSE_HALF)
            parts.append(patches)
        return templates_of(np.concatenate(parts))


@dataclass(frozen=True, eq=False)
class Landmarks:
    """M active landmarks as arrays. A landmark is a pixel of its host keyframe with an inverse depth."""

    rows: NDArray[np.intp]  #: `(M,)` increasing rows of the landmarks in the arrays of the sliding window.
    host: NDArray[np.int64]  #: `(M,)` indices of the host keyframes in the window.
    planes: LocalPlanes  #: Planes around the patches: host cameras, host pixels, inverse depths and slopes.
    estimates: LandmarkEstimates  #: Host rays and inverse depths, with their covariance given the poses.
    patches: LandmarkTemplates  #: Templates of the landmarks.
    last_seen: FloatArray  #: `(M, 4)` u, v left, u, v right in the newest keyframe, px; NaN if not observed.

    def subset(self, kept: Mask) -> Landmarks:
        """Return the landmarks for which a mask `(M,)` is True."""
        rows = np.flatnonzero(kept)
        planes = self.planes.take(rows)
        rays = self.estimates.rays.take(rows, axis=0)
        covariance = self.estimates.covariance.take(rows, axis=0)
        return Landmarks(
            rows=self.rows[rows],
            host=self.host[rows],
            planes=planes,
            estimates=LandmarkEstimates(planes.hosts, rays, planes.inverse_depth, covariance),
            patches=LandmarkTemplates(self.patches.hosted, self.patches.rows[rows]),
            last_seen=self.last_seen.take(rows, axis=0),
        )

    def thinned(self, count: int) -> Landmarks:
        """Return at most `count` landmarks at equal steps in their order, so that each host keeps its proportion."""
        if len(self.rows) <= count:
            return self
        kept = np.zeros(len(self.rows), np.bool_)
        kept[np.arange(count) * len(self.rows) // count] = True
        return self.subset(kept)

    def among(self, others: Landmarks) -> Mask:
        """Return the mask `(M,)` of the landmarks that are also in `others`, which belongs to the same window."""
        places = np.searchsorted(others.rows, self.rows)
        return np.asarray(np.append(others.rows, -1)[places] == self.rows)

    @cached_property
    def median_depth(self) -> float:
        """Median depth in the host cameras, m, at most 1 km; 0 without landmarks."""
        inverse_depth = self.planes.inverse_depth
        return 1.0 / max(float(np.median(inverse_depth)), 1.0 / MAX_DEPTH_M) if len(inverse_depth) else 0.0

    @property
    def newest_host(self) -> int:
        """Index of the newest keyframe that hosts one of the landmarks; -1 without landmarks."""
        return int(self.host.max(initial=-1))

    @property
    def points(self) -> FloatArray:
        """Points `(M, 3)` in the world, m; NaN at infinity."""
        hosts, rays, inverse_depth, _ = self.estimates
        inverse_depth = np.where(inverse_depth > MIN_INVERSE_DEPTH, inverse_depth, np.nan)
        directions = np.einsum("nij,nj->ni", hosts.rotations, rays)
        return np.asarray(directions / inverse_depth[:, None] + hosts.positions)
