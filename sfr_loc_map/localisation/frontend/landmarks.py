"""Active landmarks: the ones that are tracked in each pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sfr_loc_map.geometry.arrays import FloatArray, FloatImage, Mask, median
from sfr_loc_map.geometry.camera import Poses
from sfr_loc_map.localisation.frontend.homography import LocalPlanes
from sfr_loc_map.localisation.frontend.image_pyramid import LEVELS
from sfr_loc_map.localisation.frontend.patch import HALF, SIDE, Templates, cut_patches, templates_of, together
from sfr_loc_map.localisation.frontend.pose_solver import LandmarkEstimates

BORDER = HALF + 4
"""Pixels along the image edges where no landmark is made: its patch with the gradients must fit."""
COARSE_HALF = 3
"""Half width of a patch at the smaller levels."""
MIN_INVERSE_DEPTH = 1e-6
"""Inverse depth, 1/m, up to which a landmark is at infinity."""
ENOUGH_TO_ALIGN = 200
"""As many landmarks give a pose to some hundredths of a pixel."""
ENOUGH_TO_FOLLOW = 800
"""As many landmarks give the pose of a pair that is no keyframe: its errors do not add up."""


@dataclass(frozen=True, slots=True, eq=False)
class HostPatches:
    """Patches of the n landmarks that a keyframe hosts.

    Attributes:
        uv: `(n, 2)` their centres, whole pixels.
        fine: Their templates at full size; nobody writes to them.
        coarse: Smaller levels of the keyframe's pyramid: few landmarks are compared with these.
    """

    uv: FloatArray
    fine: Templates
    coarse: tuple[FloatImage, ...]

    @classmethod
    def none(cls) -> HostPatches:
        """Return those of a keyframe that hosts no landmark."""
        fine = Templates(np.zeros((0, 3, SIDE * SIDE), np.float32), np.zeros((0, 6)))
        return cls(np.zeros((0, 2)), fine, (np.zeros((1, 1), np.float32),) * (LEVELS - 1))


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Patches of M landmarks, copied from those of their hosts where a level is first asked for.

    Attributes:
        hosted: Those of each keyframe.
        rows: `(M,)` rows in these, increasing, counted through all keyframes.
    """

    hosted: tuple[HostPatches, ...]
    rows: NDArray[np.intp]
    _copies: dict[int, Templates] = field(default_factory=dict)

    def subset(self, kept: Mask) -> Patches:
        """Return some of them, a mask `(M,)`."""
        return Patches(self.hosted, self.rows[kept])

    def level(self, number: int) -> Templates:
        """Return the templates of the patches of a pyramid level."""
        if number not in self._copies:
            ends = np.cumsum([0, *(len(host.uv) for host in self.hosted)])
            split = np.split(self.rows, np.searchsorted(self.rows, ends[1:-1]))
            parts = [(host, rows - end) for host, end, rows in zip(self.hosted, ends, split, strict=False)]
            copied = together([(host.fine, rows) for host, rows in parts]) if number == 0 else _cut(number, parts)
            self._copies[number] = copied
        return self._copies[number]


def _cut(number: int, parts: Sequence[tuple[HostPatches, NDArray[np.intp]]]) -> Templates:
    """Return the templates of some landmarks of each host at a pyramid level from 1 on."""
    images, margin = [host.coarse[number - 1] for host, _ in parts], COARSE_HALF + 2
    small = (np.concatenate([host.uv[rows] for host, rows in parts]) + 0.5) / 2.0**number - 0.5
    last = np.max([image.shape[::-1] for image in images], axis=0) - 1 - margin  # a host of none has a small image
    inside = np.all((small >= margin) & (small <= last), axis=1)
    places = np.split(np.clip(small, margin, last), np.cumsum([len(rows) for _, rows in parts])[:-1])
    cut = [cut_patches(image, uv, COARSE_HALF) for image, uv in zip(images, places, strict=True)]
    patches = np.concatenate(cut)
    patches[~inside] = 0.0  # no texture: never in view
    return templates_of(patches)


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Active landmarks as arrays, each a host pixel with an inverse depth in its host keyframe.

    Attributes:
        index: `(M,)` rows in the sliding window.
        hosts: `(M,)` host cameras.
        uv: `(M, 2)` host pixels of the patch centres.
        rays: `(M, 3)` host rays `K^-1 (u, v, 1)` of the estimated host pixels.
        inverse_depth: `(M,)` 1/m.
        slopes: `(M, 2)` change of the inverse depth per pixel, 1/m.
        covariance: `(M, 3, 3)` of host pixel and inverse depth given the poses, px and 1/m.
        patches: Their patches.
        last_seen: `(M, 4)` u, v left, u, v right in the newest keyframe; NaN where not observed.
    """

    index: NDArray[np.intp]
    hosts: Poses
    uv: FloatArray
    rays: FloatArray
    inverse_depth: FloatArray
    slopes: FloatArray
    covariance: FloatArray
    patches: Patches
    last_seen: FloatArray

    @classmethod
    def none(cls) -> Landmarks:
        """Return no landmarks, as before the first pair."""
        vectors, matrices = np.zeros((0, 3)), np.zeros((0, 3, 3))
        index, depth, no_uv = np.zeros(0, np.intp), np.zeros(0), np.zeros((0, 2))
        patches = Patches((HostPatches.none(),), index)
        return cls(index, Poses(matrices, vectors), no_uv, vectors, depth, no_uv, matrices, patches, np.zeros((0, 4)))

    def __len__(self) -> int:
        """Return their number."""
        return len(self.index)

    def subset(self, kept: Mask) -> Landmarks:
        """Return some of them, a mask `(M,)`."""
        return Landmarks(
            self.index[kept],
            Poses(*(array[kept] for array in self.hosts)),
            self.uv[kept],
            self.rays[kept],
            self.inverse_depth[kept],
            self.slopes[kept],
            self.covariance[kept],
            self.patches.subset(kept),
            self.last_seen[kept],
        )

    def among(self, others: Landmarks) -> Mask:
        """Tell which of them `(M,)` are among others; the rows of both increase."""
        if self is others.followed:
            return np.ones(len(self), np.bool_)
        places = np.searchsorted(others.index, self.index)
        return np.asarray(np.append(others.index, -1)[places] == self.index)

    @property
    def few(self) -> Landmarks:
        """Some of them, `ENOUGH_TO_ALIGN` where there are as many, from all hosts and parts of the image."""
        return self._few if len(self) > ENOUGH_TO_ALIGN else self

    @property
    def followed(self) -> Landmarks:
        """Likewise `ENOUGH_TO_FOLLOW`."""
        return self._followed if len(self) > ENOUGH_TO_FOLLOW else self

    @cached_property
    def rest(self) -> Landmarks:
        """Those that are not followed."""
        return self.subset(~self.among(self.followed))

    def prepare(self) -> None:
        """Copy the patches that each of the next pairs is compared with."""
        self.followed.patches.level(0)
        self.rest.patches.level(0)
        for level in range(1, LEVELS):
            self.followed.few.patches.level(level)

    @cached_property
    def _few(self) -> Landmarks:
        return self._some(ENOUGH_TO_ALIGN)

    @cached_property
    def _followed(self) -> Landmarks:
        return self._some(ENOUGH_TO_FOLLOW)

    def _some(self, enough: int) -> Landmarks:
        kept = np.zeros(len(self), np.bool_)
        kept[np.arange(enough) * len(self) // enough] = True
        return self.subset(kept)

    @property
    def are_old(self) -> Mask:
        """Tell which landmarks `(M,)` other keyframes host than that of the last one."""
        positions = self.hosts.positions
        return np.asarray((positions != positions[-1:]).any(axis=1))

    @property
    def planes(self) -> LocalPlanes:
        """The planes around the landmarks' patches."""
        return LocalPlanes(self.hosts, self.uv, self.inverse_depth, self.slopes)

    @property
    def estimates(self) -> LandmarkEstimates:
        """The landmarks with their uncertainty."""
        return LandmarkEstimates(self.hosts, self.rays, self.inverse_depth, self.covariance)

    @property
    def points(self) -> FloatArray:
        """Points `(M, 3)` in the world, metres; NaN at infinity."""
        inverse_depth = np.where(self.inverse_depth > MIN_INVERSE_DEPTH, self.inverse_depth, np.nan)
        directions = np.einsum("nij,nj->ni", self.hosts.rotations, self.rays)
        return np.asarray(directions / inverse_depth[:, None] + self.hosts.positions)

    @cached_property
    def median_depth(self) -> float:
        """Median depth in the host cameras, metres, at most 1 km; 0 without landmarks."""
        return 1.0 / max(median(self.inverse_depth), 1e-3) if len(self) else 0.0
