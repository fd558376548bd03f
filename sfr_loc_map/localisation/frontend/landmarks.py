"""Active landmarks: the ones that are tracked in each pair."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.camera import Poses
from sfr_loc_map.localisation.frontend.patch import (
    HALF,
    LEVELS,
    SIDE,
    ImageLevel,
    LocalPlanes,
    Templates,
    cut_patches,
    templates_of,
)
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates

BORDER = HALF + 4  #: Pixels along the image edges where no landmark is made: its patch with the gradients must fit.
COARSE_HALF = 3  #: Half width of a patch at the smaller levels.
MIN_INVERSE_DEPTH = 1e-6  #: Inverse depth, 1/m, up to which a landmark is at infinity.
ENOUGH_TO_ALIGN = 200  #: As many landmarks give a pose to some hundredths of a pixel.
ENOUGH_TO_FOLLOW = 800  #: As many landmarks give the pose of a pair that is no keyframe: its errors do not add up.


class HostPatches(NamedTuple):
    """Patches of the n landmarks that a keyframe hosts."""

    uv: FloatArray  #: `(n, 2)` their centres, whole pixels.
    fine: Templates  #: Their templates at full size; nobody writes to them.
    coarse: tuple[ImageLevel, ...]  #: Smaller levels of the keyframe's pyramid: few landmarks are compared with these.


NO_PATCHES = HostPatches(
    np.zeros((0, 2)),
    Templates(np.zeros((0, 3, SIDE * SIDE), np.float32), np.zeros((0, 6))),
    (ImageLevel(np.zeros((1, 1), np.float32), 1.0),) * (LEVELS - 1),
)
"""Those of a keyframe that hosts no landmark."""


class Patches(dict[int, Templates]):
    """Templates of M landmarks by pyramid level: increasing `rows` `(M,)` of all hosts', copied when asked for."""

    def __init__(self, hosted: tuple[HostPatches, ...], rows: NDArray[np.intp]) -> None:
        super().__init__()
        self.hosted, self.rows = hosted, rows

    def __missing__(self, level: int) -> Templates:
        """Copy the templates of a level."""
        ends = np.cumsum([0, *(len(host.uv) for host in self.hosted)])
        split = np.split(self.rows, np.searchsorted(self.rows, ends[1:-1]))
        parts = [(host, rows - end) for host, end, rows in zip(self.hosted, ends, split, strict=False)]
        if level == 0:
            count, size = len(self.rows), parts[-1][0].fine.values.shape[2]
            values, moments = np.empty((count, 3, size), np.float32), np.empty((count, 6))
            first = 0
            for host, rows in parts:
                place = slice(first, first + len(rows))
                # by mode "raise" it would copy twice
                np.take(host.fine.values, rows, axis=0, out=values[place], mode="clip")
                moments[place] = host.fine.moments[rows]
                first += len(rows)
            self[level] = Templates(values, moments)
            return self[level]
        images, margin = [host.coarse[level - 1].image for host, _ in parts], COARSE_HALF + 2
        small = (np.concatenate([host.uv[rows] for host, rows in parts]) + 0.5) / 2.0**level - 0.5
        last = np.max([image.shape[::-1] for image in images], axis=0) - 1 - margin  # a host of none has a small image
        inside = np.all((small >= margin) & (small <= last), axis=1)
        places = np.split(np.clip(small, margin, last), np.cumsum([len(rows) for _, rows in parts])[:-1])
        patches = np.concatenate(
            [cut_patches(image, uv, COARSE_HALF) for image, uv in zip(images, places, strict=True)]
        )
        patches[~inside] = 0.0  # no texture: never in view
        self[level] = templates_of(patches)
        return self[level]


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Active landmarks as arrays, each a host pixel with an inverse depth in its host keyframe."""

    index: NDArray[np.intp]  #: `(M,)` rows in the sliding window, increasing.
    planes: LocalPlanes  #: The planes around their patches: host cameras, host pixels, inverse depths and slopes.
    #: Host rays of the estimated host pixels, and what is known of the landmarks given the poses.
    estimates: LandmarkEstimates
    patches: Patches  #: Their patches.
    last_seen: FloatArray  #: `(M, 4)` u, v left, u, v right in the newest keyframe; NaN where not observed.

    @classmethod
    def none(cls) -> Landmarks:
        """Return no landmarks, as before the first pair."""
        index, depth, uv = np.zeros(0, np.intp), np.zeros(0), np.zeros((0, 2))
        vectors, matrices = np.zeros((0, 3)), np.zeros((0, 3, 3))
        hosts = Poses(matrices, vectors)
        planes, estimates = LocalPlanes(hosts, uv, depth, uv), LandmarkEstimates(hosts, vectors, depth, matrices)
        return cls(index, planes, estimates, Patches((NO_PATCHES,), index), np.zeros((0, 4)))

    def subset(self, kept: Mask) -> Landmarks:
        """Return some of them, a mask `(M,)`."""
        _, uv, inverse_depth, slopes = self.planes
        hosts, rays, _, covariance = self.estimates
        hosts, inverse_depth = Poses(*(array[kept] for array in hosts)), inverse_depth[kept]
        return Landmarks(
            self.index[kept],
            LocalPlanes(hosts, uv[kept], inverse_depth, slopes[kept]),
            LandmarkEstimates(hosts, rays[kept], inverse_depth, covariance[kept]),
            Patches(self.patches.hosted, self.patches.rows[kept]),
            self.last_seen[kept],
        )

    def among(self, others: Landmarks) -> Mask:
        """Tell which of them `(M,)` are among others."""
        if self is others.followed:
            return np.ones(len(self.index), np.bool_)
        places = np.searchsorted(others.index, self.index)
        return np.asarray(np.append(others.index, -1)[places] == self.index)

    @cached_property
    def few(self) -> Landmarks:
        """Some of them, `ENOUGH_TO_ALIGN` where there are as many, from all hosts and parts of the image."""
        return self._some(ENOUGH_TO_ALIGN)

    @cached_property
    def followed(self) -> Landmarks:
        """Likewise `ENOUGH_TO_FOLLOW`."""
        return self._some(ENOUGH_TO_FOLLOW)

    @cached_property
    def rest(self) -> Landmarks:
        """Those that are not followed."""
        return self.subset(~self.among(self.followed))

    @cached_property
    def median_depth(self) -> float:
        """Median depth in the host cameras, metres, at most 1 km; 0 without landmarks."""
        inverse_depth = self.planes.inverse_depth
        return 1.0 / max(float(np.median(inverse_depth)), 1e-3) if len(inverse_depth) else 0.0

    def _some(self, enough: int) -> Landmarks:
        if len(self.index) <= enough:
            return copy(self)  # itself would be a cycle, which keeps its patches, megabytes
        kept = np.zeros(len(self.index), np.bool_)
        kept[np.arange(enough) * len(self.index) // enough] = True
        return self.subset(kept)

    @property
    def are_old(self) -> Mask:
        """Tell which landmarks `(M,)` other keyframes host than that of the last one."""
        positions = self.planes.hosts.positions
        return np.asarray((positions != positions[-1:]).any(axis=1))

    @property
    def points(self) -> FloatArray:
        """Points `(M, 3)` in the world, metres; NaN at infinity."""
        hosts, rays, inverse_depth, _ = self.estimates
        inverse_depth = np.where(inverse_depth > MIN_INVERSE_DEPTH, inverse_depth, np.nan)
        directions = np.einsum("nij,nj->ni", hosts.rotations, rays)
        return np.asarray(directions / inverse_depth[:, None] + hosts.positions)
