"""Disparities of mappers against the true ones, over the true pixels that both images see (make disparity-accuracy).

    PYTHONPATH=. python test/mapping/disparity_accuracy.py SRC [METHOD...]

Density: share of these pixels that have a disparity; share wrong by more than 1 and 2 pixels; mean absolute error;
bias: median; sigma: 1.4826 times the median absolute deviation.
"""

import sys
from pathlib import Path

import numpy as np

from sfr_loc_map.geometry.arrays import FloatArray, Mask
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoRig
from sfr_loc_map.inputs import Task
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.semi_global_matching import search_range
from sfr_loc_map.methods.comparison import LIMITS
from sfr_loc_map.methods.isolated_method import IsolatedMethod
from sfr_loc_map.methods.registry import find_method

OCCLUSION_PX = 1.0
"""A pixel is occluded in the right image where a surface nearer by more than this disparity covers its partner."""


def true_disparity(item: PosedStereoPair, rig: StereoRig) -> FloatArray:
    """Return the true disparities of a pair `(H, W)`, NaN where none."""
    assert item.truth is not None, "the source has no ground truth"
    T_lm_left = item.T_lm_navsb @ rig.T_sb_left
    depth = (item.truth.astype(np.float64) - T_lm_left.translation) @ T_lm_left.rotation[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return rig.fx * rig.baseline_m / depth


def visible_in_both(disparity_px: FloatArray) -> Mask:
    """Return which pixels of the left image `(H, W)` the right one sees too: within it, and with nothing in front."""
    height, width = disparity_px.shape
    rows, columns = np.nonzero(np.isfinite(disparity_px) & (disparity_px > 0))
    disparity = disparity_px[rows, columns]
    partner = columns - disparity
    inside = (partner >= 0) & (partner <= width - 1)
    rows, columns, disparity, partner = rows[inside], columns[inside], disparity[inside], partner[inside]
    nearest = np.zeros((height, width + 1))
    whole = np.floor(partner).astype(np.intp)
    np.maximum.at(nearest, (rows, whole), disparity)
    np.maximum.at(nearest, (rows, whole + 1), disparity)
    front = nearest[rows, np.rint(partner).astype(np.intp)] <= disparity + OCCLUSION_PX
    visible = np.zeros((height, width), np.bool_)
    visible[rows[front], columns[front]] = True
    return visible


def main(source: str, *methods: str) -> int:
    sequence = open_source(Path(source)).nav
    assert sequence is not None, f"no mapping pairs in {source}"
    rig, items = sequence.rig, list(sequence.pairs())
    truths = [true_disparity(item, rig) for item in items]
    setup = {"disparities": search_range(rig, MappingConfig()).count}
    print("method      density   bad-1 %   bad-2 %    MAE px   bias px  sigma px")
    for name in methods or ("sfr", "sgbm"):
        with IsolatedMethod(find_method(name, Task.MAPPING), rig, limits=LIMITS, setup=setup) as mapper:
            found = [mapper.map_pair(item.pair, item.T_lm_navsb, 0)[0].disparity_px for item in items]
        seen = [visible_in_both(truth) for truth in truths]
        error = np.concatenate([(d - t)[mask] for d, t, mask in zip(found, truths, seen, strict=True)])
        density, error = np.isfinite(error).mean(), error[np.isfinite(error)]
        size, bias = np.abs(error), np.median(error)
        sigma = 1.4826 * np.median(np.abs(error - bias))
        figures = (density, 100 * np.mean(size > 1.0), 100 * np.mean(size > 2.0), size.mean(), bias, sigma)
        print(f"{name:9}" + "".join(f"{figure:10.4g}" for figure in figures), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
