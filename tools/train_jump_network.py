"""Train the network that classifies pixels near disparity jumps; see `mapping/disparity/validity/jump_network.py`.

    python tools/train_jump_network.py sfr_loc_map/mapping/disparity/validity/jump_network.json SOURCE ...

Each SOURCE has mapping pairs with ground truth (`sfr simulate`). Each pair is used unchanged and with images of other
simulated cameras: more noise, lower contrast, local gain differences, vertical disparity, blur, higher contrast. The
result depends only on the sources.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sfr_loc_map.geometry.arrays import F
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import panorama_of
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity import matching_cost, surfaces
from sfr_loc_map.mapping.disparity.refinement.cell_field import cells_from_disparity, disparity_from_cells
from sfr_loc_map.mapping.disparity.refinement.variational_refinement import RefinedDisparity, refine_disparity
from sfr_loc_map.mapping.disparity.right_camera.right_image_correction import correct_right_image
from sfr_loc_map.mapping.disparity.semi_global_matching import search_range_of, semi_global_matching
from sfr_loc_map.mapping.disparity.surfaces import DisparityScene
from sfr_loc_map.mapping.disparity.validity import jump_network
from sfr_loc_map.mapping.disparity.validity.jump_network import (
    JumpFeatures,
    JumpNetwork,
    classified_pixels,
    jump_features,
    network_input,
)
from sfr_loc_map.mapping.disparity.validity.pixel_status import judge_before_wrong_surface
from sfr_loc_map.mapping.filters import local_variance

INPUTS = len(JumpFeatures._fields)
UNITS = 16
"""Number of units of the hidden layer."""
PASSES, BATCH, RATE = 30, 512, 3e-3
MOST = 16_000
"""Largest number of pixels that are used per pair."""
WRONG_PX = 1.0
"""Disparity error, px, above which a pixel is on the wrong surface."""
MAX_COST = 30.0
"""Largest weight of a pixel. The weight is the disparity error, px, because large errors corrupt a map more."""
WINDOW_CONSTANTS = ("WINDOW_RADIUS", "MAX_DIFFERENCE", "NO_COST", "GREY_SCALE", "DISTANCE_SCALE_PX")
JUMP_CONSTANTS = (
    "SMALL_JUMP_PX",
    "SURFACE_RADIUS",
    "OCCLUDER_COLUMNS",
    "SAME_COLUMN_PX",
    "MAX_LOG",
    "MIN_TYPICAL_COST",
    "MIN_RELATIVE_COST",
    "WINDOW_MARGIN_SCALE",
)
REFERENCE = Path(__file__).resolve().parents[1] / "sample" / "spirit-1"
"""Pair whose inputs are stored with the weights. A test compares them with those of the code."""
Images = tuple[np.ndarray, np.ndarray]


def changed(left: np.ndarray, right: np.ndarray, random: np.random.Generator) -> Iterator[Images]:
    """Yield the images of other simulated cameras, float64 grey levels."""
    mean = left.mean()
    yield left, right
    yield tuple(mean + 0.6 * (x - mean) + random.normal(0.0, 6.5, x.shape) for x in (left, right))
    gain = random.normal(1.0, 0.03, (right.shape[0] // 24, right.shape[1] // 24))
    patchy = right * cv2.resize(gain, right.shape[::-1], interpolation=cv2.INTER_CUBIC)
    shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, random.uniform(-0.4, 0.4)]])
    shifted = cv2.warpAffine(patchy, shift, right.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    yield tuple(x + random.normal(0.0, 1.5, x.shape) for x in (left, shifted))
    sigmas = random.uniform(0.3, 0.6), random.uniform(0.5, 0.8)
    blurred = (cv2.GaussianBlur(x, (0, 0), sigma) for x, sigma in zip((left, right), sigmas, strict=True))
    yield tuple(x + random.normal(0.0, 1.0, x.shape) for x in blurred)
    yield tuple(mean + 1.6 * (x - mean) for x in (left, right))


def true_disparity(posed: PosedStereoPair, rig: StereoRig) -> np.ndarray:
    """Return the true disparity `(H, W)`, pixels, NaN where unknown."""
    depth = (posed.T_lm_navsb @ rig.T_sb_left).inverse().apply(posed.truth)[..., 2]
    return rig.fx * rig.baseline_m / np.where(depth > 0.0, depth, np.nan)


def samples(source: Path, random: np.random.Generator) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the network inputs `(N, 13)` and disparity errors `(N,)`, pixels, of each variant of each pair."""
    panorama = panorama_of(open_source(source))
    for posed in panorama.pairs():
        truth = true_disparity(posed, panorama.rig)
        for images in changed(posed.pair.left.astype(float), posed.pair.right.astype(float), random):
            left, right = (np.clip(np.rint(x), 0, 255).astype(np.uint8) for x in images)
            scene = scene_of(StereoPair(posed.pair.stamp_ns, left, right), panorama.rig)
            classified = classified_pixels(scene)
            chosen = classified[np.isfinite(truth.flat[classified])]
            inputs = network_input(jump_features(scene, chosen))
            error_px = np.abs((scene.disparity - truth).flat[chosen])
            some = random.permutation(len(chosen))[:MOST]
            yield inputs[some].astype(float), error_px[some]


def refined_scene(pair: StereoPair, rig: StereoRig) -> tuple[DisparityScene, RefinedDisparity]:
    """Return the scene and the refined disparity of a pair as `estimate_disparity` computes them before validity."""
    left = pair.left.astype(F, order="C")
    right = pair.right.astype(F, order="C")
    matched_px = semi_global_matching(pair.left, pair.right, search_range_of(rig, MappingConfig()).count)
    cells = cells_from_disparity(matched_px)
    right, _ = correct_right_image(left, right, disparity_from_cells(cells, left.shape), rig.camera)
    refined = refine_disparity(left, right, cells)
    return DisparityScene(left, right, matched_px, refined.px, refined.sigma_px, np.isfinite(matched_px)), refined


def scene_of(pair: StereoPair, rig: StereoRig) -> DisparityScene:
    """Return the input of the network as the mapper computes it with default parameters."""
    scene, refined = refined_scene(pair, rig)
    judged, _ = judge_before_wrong_surface(scene, refined, local_variance(scene.left))
    return judged


def reference_inputs() -> dict[str, Any]:
    """Return the number of classified pixels of the reference pair, and the means of their inputs `(13,)`."""
    panorama = panorama_of(open_source(REFERENCE))
    scene = scene_of(next(iter(panorama.pairs())).pair, panorama.rig)
    inputs = network_input(jump_features(scene, classified_pixels(scene)))
    return {"pixels": len(inputs), "mean_inputs": np.round(inputs.mean(axis=0, dtype=float), 4).tolist()}


def train(features: np.ndarray, error_px: np.ndarray, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Return the weights that minimise the weighted cross entropy (Adam: Kingma and Ba 2015)."""
    low, high = np.percentile(features, (0.5, 99.5), axis=0)
    features = np.clip(features, low, high)
    mean, scale = features.mean(0), features.std(0)
    inputs, target = (features - mean) / scale, (error_px > WRONG_PX).astype(float)
    cost = np.clip(error_px, 1.0, MAX_COST)
    weights = [
        random.normal(0.0, np.sqrt(2.0 / INPUTS), (UNITS, INPUTS)),
        np.zeros(UNITS),
        random.normal(0.0, np.sqrt(1.0 / UNITS), UNITS),
        np.zeros(1),
    ]
    first, second = [np.zeros_like(w) for w in weights], [np.zeros_like(w) for w in weights]
    step = 0
    for number in range(PASSES):
        rate = RATE * 0.5 * (1.0 + np.cos(np.pi * number / PASSES))
        order, loss = random.permutation(len(inputs)), 0.0
        for start in range(0, len(order) - BATCH, BATCH):
            batch = order[start : start + BATCH]
            x, y = inputs[batch], target[batch]
            units = np.maximum(x @ weights[0].T + weights[1], 0.0)
            odds = units @ weights[2] + weights[3][0]
            error = cost[batch] * (1.0 / (1.0 + np.exp(-odds)) - y) / BATCH
            back = error[:, None] * weights[2] * (units > 0.0)
            loss += float((cost[batch] * (np.logaddexp(0.0, odds) - y * odds)).mean())
            step += 1
            for k, gradient in enumerate((back.T @ x, back.sum(0), error @ units, error.sum(keepdims=True))):
                first[k] += 0.1 * (gradient - first[k])
                second[k] += 0.001 * (gradient**2 - second[k])
                size = np.sqrt(second[k] / (1.0 - 0.999**step)) + 1e-8
                weights[k] -= rate * (first[k] / (1.0 - 0.9**step)) / size
        print(f"pass {number + 1} of {PASSES}: cross entropy {loss / (len(order) // BATCH):.4f}", flush=True)
    hidden = weights[0] / scale
    return dict(zip(JumpNetwork._fields, (low, high, hidden, weights[1] - hidden @ mean, *weights[2:]), strict=True))


def feature_constants() -> dict[str, float]:
    """Return the constants of the features by name, except those of sigma and slopes."""
    modules = {matching_cost: WINDOW_CONSTANTS, surfaces: ("SURFACE_JUMP_PX",), jump_network: JUMP_CONSTANTS}
    found = {name: getattr(module, name) for module, names in modules.items() for name in names}
    return {name: round(float(value), 4) for name, value in found.items()}


def main(out: Path, sources: list[Path]) -> None:
    """Train on the sources and write the network."""
    random = np.random.default_rng(0)
    found = [item for source in sources for item in samples(source, random)]
    features, error_px = (np.concatenate(parts) for parts in zip(*found, strict=True))
    print(f"{len(error_px)} pixels, {100 * (error_px > WRONG_PX).mean():.1f} % of them on the wrong surface")
    weights = train(features, error_px, random)
    lines = [f'"constants": {json.dumps(feature_constants())}', f'"reference": {json.dumps(reference_inputs())}']
    lines += [f'"{name}": {json.dumps(np.round(value, 4).tolist())}' for name, value in weights.items()]
    out.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(item) for item in sys.argv[2:]])
