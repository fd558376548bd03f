"""The mapper against worlds whose disparity is known, against faults, and against the development data."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
import pytest

from helpers import ROOT
from helpers.disparity_world import hills, make_world, slope
from helpers.hazard_truth import hazard_accuracy
from sfr_loc_map.errors import GeometryError, MappingError
from sfr_loc_map.geometry.cloud import COLUMNS
from sfr_loc_map.geometry.rotation import matrix_from_rotvec
from sfr_loc_map.geometry.stereo import PosedStereoPair, StereoPair, StereoRig
from sfr_loc_map.geometry.transform import Transform
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import panorama_of
from sfr_loc_map.jit import KERNELS
from sfr_loc_map.mapping.checks import MAX_LM_M
from sfr_loc_map.mapping.config import MappingConfig
from sfr_loc_map.mapping.disparity.validity.pixel_status import PixelStatus
from sfr_loc_map.mapping.mapper import Mapper
from sfr_loc_map.mapping.maps import MappedPair, PairMap

T_LM_NAVSB = Transform(matrix_from_rotvec([0.1, 0.35, -0.4]), np.array([1.0, -2.0, 2.0]))
SAMPLE = ROOT / "sample"
INNER = np.s_[16:-16, 48:-16]
"""Pixels whose neighbourhood both cameras see."""


def mapped(made: Any, **change: Any) -> MappedPair:
    return Mapper(made.rig, MappingConfig(**change)).process(made.pair, T_LM_NAVSB, 0)


def errors(made: Any, result: PairMap) -> np.ndarray:
    difference = (result.disparity_px - made.disparity)[INNER]
    return difference[np.isfinite(difference)]


def test_plane_is_unbiased_and_dense_without_pixel_locking() -> None:
    """The error does not follow the fraction of the disparity, as it does where parabolas are fitted to costs."""
    made = make_world(slope, width=511, height=255, seed=5)
    result = mapped(made)
    error = errors(made, result)
    assert len(error) > 0.98 * made.disparity[INNER].size
    assert abs(error.mean()) < 0.005
    assert error.std() < 0.02
    assert np.abs(error).max() < 0.25
    error, phase = (result.disparity_px - made.disparity)[INNER], 2.0 * np.pi * made.disparity[INNER]
    for wave in (np.sin(phase), np.cos(phase)):
        assert abs(np.nanmean(error * wave) * 2.0) < 0.003


def coarse(bits: int) -> Callable[[np.ndarray], np.ndarray]:
    step = 256 >> bits
    return lambda image: image // step * step + step // 2


FILTERS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], float]] = {
    "none": (lambda image: image, 0.97),
    "median": (lambda image: cv2.medianBlur(image, 5), 0.97),
    "Gauss": (lambda image: cv2.GaussianBlur(image, (0, 0), 1.5), 0.97),
    "JPEG": (lambda image: cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 30])[1], 0), 0.97),
    "3 bits": (coarse(3), 0.97),
    "2 bits": (coarse(2), 0.97),
}
"""What images may have gone through, and the share of errors that must lie within three sigmas."""


@pytest.mark.parametrize(("noise", "images"), [(2.0, "none"), *((5.0, name) for name in FILTERS)])
def test_sigma_is_calibrated_on_hills(noise: float, images: str) -> None:
    """Noise that filters and compression leave is correlated: it is smaller in a pixel than over several."""
    made = make_world(hills, width=512, height=384, noise=noise, seed=3)
    change, within = FILTERS[images]
    made = replace(made, pair=StereoPair(0, change(made.pair.left), change(made.pair.right)))
    result = mapped(made)
    cloud = result.cloud
    scale = made.rig.fx * made.rig.baseline_m
    rays = np.hypot(np.hypot((cloud.u - made.rig.cx) / made.rig.fx, (cloud.v - made.rig.cy) / made.rig.fy), 1.0)
    along = (scale / result.disparity_px - scale / made.disparity)[cloud.v, cloud.u] * rays
    inner = (cloud.u > 48) & (cloud.u < 496) & (cloud.v > 16) & (cloud.v < 368)
    size = np.abs(along / result.random_sigma)[inner]
    assert 0.60 < (size < 1).mean() < (0.99 if "bits" in images else 0.93)  # noise dithers coarse grey levels
    assert (size < 2).mean() > within - 0.07
    assert (size < 3).mean() > within


@pytest.mark.parametrize("rows", [-0.5, 0.25, 0.5])
def test_vertical_disparity_and_unequal_exposure_are_measured_and_compensated(rows: float) -> None:
    made = make_world(slope, rows=rows, gain=0.8, offset=20.0)
    result = mapped(made)
    assert result.statistics["vertical_offset_px"] == pytest.approx(rows, abs=0.06)
    assert result.statistics["gain"] == pytest.approx(0.8, abs=0.03)
    assert abs(errors(made, result).mean()) < 0.015
    assert errors(made, result).std() < 0.015
    told = [any(word in line for line in result.warnings) for word in ("vertical", "contrast")]
    assert told == [False, True]  # rows: no more than typical left-over distortion


def test_the_map_of_a_set_has_the_warnings_of_its_pairs_and_of_the_fusion() -> None:
    made, darker = make_world(slope), make_world(slope, gain=0.8)
    mapper = Mapper(made.rig)
    fused = mapper.map([PosedStereoPair(item.pair, T_LM_NAVSB) for item in (made, darker)])
    assert [line.partition(" has")[0] for line in fused.warnings] == ["pair 1: the right image"]
    away = T_LM_NAVSB @ Transform(matrix_from_rotvec([0.0, 0.0, 0.02]), np.zeros(3))
    fused = mapper.map([PosedStereoPair(made.pair, T_LM_NAVSB), PosedStereoPair(darker.pair, away)])
    assert [line.partition(" ")[0] for line in fused.warnings] == ["pair", "pairs"]


@pytest.mark.parametrize(("noise", "blur"), [(1.2, 0.0), (2.5, 0.6)])
def test_a_sky_of_noise_has_no_points(noise: float, blur: float) -> None:
    """The ground's residuals are larger than the sky's noise, as where it is textured finely."""
    made = make_world(slope, width=384, height=320, noise=4.0, seed=5)
    rng = np.random.default_rng(11)
    images = []
    for image in (made.pair.left.copy(), made.pair.right.copy()):
        grain = rng.normal(0.0, 1.0, image[:192].shape)
        if blur:
            grain = cv2.GaussianBlur(grain, (0, 0), blur)
        image[:192] = np.rint(165.0 - 0.05 * np.arange(192)[:, None] + noise / grain.std() * grain)
        images.append(image)
    result = mapped(replace(made, pair=StereoPair(0, *images)))
    assert not np.isfinite(result.disparity_px[:176]).any()
    assert np.isfinite(result.disparity_px[208:-16, 64:-16]).mean() > 0.95


def test_same_input_gives_same_bits_on_any_number_of_threads() -> None:
    made = make_world(hills)
    several = mapped(made)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = mapped(made)
    finally:
        numba.set_num_threads(threads)
    assert one.cloud.to_structured().tobytes() == several.cloud.to_structured().tobytes()


def in_larger_image(image: np.ndarray) -> np.ndarray:
    larger = np.zeros((image.shape[0] + 3, image.shape[1] + 5), np.uint8)
    larger[2:-1, 3:-2] = image
    return larger[2:-1, 3:-2]


LAYOUTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "column by column": np.asfortranarray,
    "part of a larger image": in_larger_image,
    "read only": lambda image: np.frombuffer(image.tobytes(), np.uint8).reshape(image.shape),
    "backwards": lambda image: image[::-1].copy()[::-1],
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_images_of_any_memory_layout_give_the_same_map(layout: str) -> None:
    """No kernel is compiled for another memory layout, which would take longer than the call."""
    made = make_world(hills)
    change = LAYOUTS[layout]
    other = replace(made, pair=StereoPair(0, change(made.pair.left), change(made.pair.right)))
    expected = mapped(made).cloud.to_structured().tobytes()
    compiled = sum(len(kernel.signatures) for kernel in KERNELS)
    assert mapped(other).cloud.to_structured().tobytes() == expected
    assert sum(len(kernel.signatures) for kernel in KERNELS) == compiled


def arrays_of(pair_map: PairMap) -> list[bytes]:
    assert isinstance(pair_map, MappedPair)
    cloud, view = pair_map.cloud, pair_map.view
    saturation = view.saturation
    arrays = (cloud.to_structured(), *view.points, pair_map.random_sigma, pair_map.disparity_px)
    return [array.tobytes() for array in (*arrays, saturation.square_saturated, saturation.nearby_fraction_255)]


def test_calls_change_neither_their_input_nor_the_mapper() -> None:
    """Maps of pairs are fused again, alone and together, whatever was mapped between: the results are bit-identical."""
    one, other = (make_world(hills, noise=3.0, noise_seed=seed) for seed in (1, 2))
    clipped = one.pair.right.copy()
    clipped[100:130, 60:140] = 255
    pairs = [StereoPair(1, one.pair.left, clipped), other.pair]
    images = [image.tobytes() for pair in pairs for image in (pair.left, pair.right)]
    mapper = Mapper(one.rig, MappingConfig(refine_poses=True))
    maps = [mapper.process(pair, T_LM_NAVSB, index) for index, pair in enumerate(pairs)]
    before = [arrays_of(item) for item in maps]
    fused = [mapper.fuse(maps), mapper.fuse(maps[::-1]), mapper.fuse(maps)]
    assert fused[0].cloud.to_structured().tobytes() == fused[2].cloud.to_structured().tobytes()
    assert [arrays_of(item) for item in maps] == before
    assert [image.tobytes() for pair in pairs for image in (pair.left, pair.right)] == images
    again = mapper.process(pairs[0], T_LM_NAVSB, 0)
    assert arrays_of(again) == before[0]


def test_step_is_not_smeared() -> None:
    """A block that stands 6 pixels of disparity before its background: what is kept is one or the other."""
    block, ground = (make_world(lambda u, v, d=d: np.full_like(u, d), width=400, height=280) for d in (16.0, 10.0))
    v, u = np.mgrid[:280, :400]
    nearer, shifted = ((np.abs(c - 200.0) < 45.0) & (np.abs(v - 130.0) < 45.0) for c in (u, u + 16.0))
    left, right = (
        np.where(nearer, block.pair.left, ground.pair.left),
        np.where(shifted, block.pair.right, ground.pair.right),
    )
    made = replace(ground, pair=StereoPair(0, left, right), disparity=np.where(nearer, 16.0, 10.0))
    error = np.abs(errors(made, mapped(made)))
    assert len(error) > 0.9 * made.disparity[INNER].size
    assert (error > 0.5).mean() < 0.01


@pytest.mark.clause("1.3", "3.2.5")
def test_points_lie_on_their_pixels_rays_at_the_depth_of_their_disparity() -> None:
    made = make_world(slope)
    result = mapped(made)
    local = (T_LM_NAVSB @ made.rig.T_sb_left).inverse().apply(result.cloud.xyz)
    np.testing.assert_allclose(made.rig.fx * local[:, 0] / local[:, 2] + made.rig.cx, result.cloud.u, atol=2e-3)
    np.testing.assert_allclose(made.rig.fy * local[:, 1] / local[:, 2] + made.rig.cy, result.cloud.v, atol=2e-3)
    disparity = result.disparity_px[result.cloud.v, result.cloud.u]
    np.testing.assert_allclose(local[:, 2], made.rig.fx * made.rig.baseline_m / disparity, rtol=1e-5)
    np.testing.assert_array_equal(result.cloud.intensity, made.pair.left[result.cloud.v, result.cloud.u])
    assert len(result.cloud) == np.isfinite(result.disparity_px).sum()
    near = mapped(made, max_range_m=3.0)
    assert made.rig.fx * made.rig.baseline_m / np.nanmin(near.disparity_px) <= 3.0 + 1e-5


def test_the_status_of_a_pixel_says_why_it_has_no_point() -> None:
    """With a smaller range the same pixels are valid, but for those that are beyond it."""
    made = make_world(slope)
    result = mapped(made)
    near = mapped(made, max_range_m=3.0)
    is_valid = result.pixel_status <= PixelStatus.FILLED
    np.testing.assert_array_equal(is_valid, np.isfinite(result.disparity_px))
    is_beyond = near.pixel_status == PixelStatus.BEYOND_RANGE
    np.testing.assert_array_equal(near.pixel_status[~is_beyond], result.pixel_status[~is_beyond])
    assert is_valid[is_beyond].all()
    assert (made.rig.fx * made.rig.baseline_m / result.disparity_px[is_beyond]).min() > 3.0
    outside = np.arange(made.rig.width) < np.rint(made.disparity) - 1.0  # of the right image
    hidden = (PixelStatus.UNMATCHED, PixelStatus.CHANGED, PixelStatus.OCCLUDED)
    assert np.isin(result.pixel_status[outside], hidden).mean() > 0.98
    assert result.statistics["density"] == pytest.approx(is_valid.mean())
    filled = result.pixel_status == PixelStatus.FILLED
    assert filled.any()
    assert result.statistics["filled_share"] == pytest.approx(filled.sum() / len(result.cloud))


FAULTS: dict[str, tuple[Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]], str]] = {
    "swapped": (lambda a, b: (b, a), "swapped"),
    "black right": (lambda a, b: (a, np.zeros_like(b)), "right image .* is textureless"),
    "white left": (lambda a, b: (np.full_like(a, 255), b), "left image .* is textureless"),
    "twice the same": (lambda a, b: (a, a), "identical"),
    "upside down": (lambda a, b: (a, b[::-1].copy()), "do not match"),
    "lower rows": (lambda a, b: (a, np.roll(b, 12, axis=0)), r"1\d rows lower"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_images_that_cannot_match_are_refused_by_name(name: str) -> None:
    made = make_world(slope, width=384, height=320)
    corrupt, message = FAULTS[name]
    with pytest.raises(MappingError, match=message):
        mapped(replace(made, pair=StereoPair(7, *corrupt(made.pair.left, made.pair.right))))


def test_wrong_size_and_index_and_maps_of_other_methods_are_refused() -> None:
    made = make_world(slope)
    mapper = Mapper(made.rig, MappingConfig())
    with pytest.raises(MappingError, match="the size of the rig"):
        mapper.process(StereoPair(0, made.pair.left[:-1], made.pair.right[:-1]), T_LM_NAVSB, 0)
    for index in (-1, 3, 1.5, True):
        with pytest.raises(MappingError, match="index"):
            mapper.process(made.pair, T_LM_NAVSB, index)  # type: ignore[arg-type]
    with pytest.raises(MappingError, match="4 pairs given"):
        mapper.map([PosedStereoPair(made.pair, T_LM_NAVSB)] * 4)
    wider = Mapper(replace(made.rig, baseline_m=1.5 * made.rig.baseline_m))
    with pytest.raises(MappingError, match="other cameras"):
        mapper.fuse([wider.process(made.pair, T_LM_NAVSB, 0)])
    own = mapped(made)
    foreign = PairMap(7, own.cloud, own.random_sigma, own.T_lm_left, own.disparity_px)
    with pytest.raises(MappingError, match="a sequence of maps that"):
        mapper.fuse([foreign])  # type: ignore[list-item]


@pytest.mark.parametrize(
    ("rotation", "position", "message"),
    [
        (2.0 * np.eye(3), [0.0, 0.0, 0.0], "invalid rotation"),
        (np.diag([1.0, 1.0, -1.0]), [0.0, 0.0, 0.0], "invalid rotation"),
        (np.eye(3), [4.5e5, 5.4e6, 300.0], "choose an origin of LM near the rover"),
        (np.eye(3), [0.0, 0.0, -1.01 * MAX_LM_M], "choose an origin of LM near the rover"),
    ],
)
def test_a_pose_that_is_no_rotation_or_far_from_the_origin_is_refused(
    rotation: np.ndarray, position: list[float], message: str
) -> None:
    made = make_world(slope)
    pair = PosedStereoPair(made.pair, Transform(rotation, np.array(position)))
    with pytest.raises(MappingError, match=message):
        Mapper(made.rig).map([pair])


@pytest.mark.parametrize("wrong", [3, None, "x", [3]])
def test_an_argument_of_another_type_is_refused(wrong: Any) -> None:
    rig = StereoRig(64, 48, 60.0, 60.0, 31.5, 23.5, 0.2)
    image = np.random.default_rng(0).integers(0, 255, (48, 64), dtype=np.uint8)
    pair = StereoPair(0, image, np.roll(image, -3, axis=1))
    mapper = Mapper(rig)
    with pytest.raises(GeometryError, match="a StereoRig is required"):
        Mapper(wrong)
    calls: list[tuple[str, Callable[[], object]]] = [
        ("a StereoPair", lambda: mapper.process(wrong, Transform.identity())),
        ("a Transform", lambda: mapper.process(pair, wrong)),
        ("a sequence of PosedStereoPair", lambda: mapper.map(wrong)),
        ("a sequence of maps that `Mapper.process` returned", lambda: mapper.fuse(wrong)),
    ]
    for required, call in calls:
        with pytest.raises(MappingError, match=f"{required} is required"):
            call()


@pytest.mark.parametrize(("width", "height"), [(1, 1), (8, 8), (100, 15), (15, 100), (16, 16), (100, 16), (33, 17)])
@pytest.mark.parametrize("right", ["shifted", "negative"])
def test_small_images_are_refused_or_processed(width: int, height: int, right: str) -> None:
    side = max(width, height)
    rig = StereoRig(width, height, side, side, width / 2, height / 2, 0.1)
    if min(width, height) < 16:
        with pytest.raises(GeometryError, match="at least 16 x 16 px"):
            Mapper(rig)
        return
    image = np.random.default_rng(2).integers(0, 255, (height, width), dtype=np.uint8)
    second = np.roll(image, -2, axis=1) if right == "shifted" else 255 - image
    try:
        found = Mapper(rig).process(StereoPair(0, image, second), Transform.identity())
    except MappingError as error:
        assert "do not match" in str(error)  # noqa: PT017
    else:
        assert found.disparity_px.shape == (height, width)


def test_a_map_without_points_has_a_warning_that_names_the_range() -> None:
    made = make_world(slope)
    scale = made.rig.fx * made.rig.baseline_m
    nearest_px = float(np.nanmax(made.disparity))
    ranges = {"min_range_m": scale / (2.0 * nearest_px), "max_range_m": scale / (1.5 * nearest_px)}
    result = mapped(made, **ranges)
    assert not len(result.cloud)
    assert any("max_range_m" in line for line in result.warnings)
    fused = Mapper(made.rig, MappingConfig(**ranges)).fuse([result])
    assert not len(fused.cloud)
    assert any("no points" in line for line in fused.warnings)
    assert not any("no points" in line for line in mapped(made).warnings)


def test_a_range_that_excludes_much_of_the_scene_has_a_warning() -> None:
    made = make_world(slope)
    depths = made.rig.fx * made.rig.baseline_m / made.disparity
    with pytest.raises(MappingError, match="min_range_m"):
        mapped(made, min_range_m=float(np.nanquantile(depths, 0.9)))
    assert any("max_range_m" in line for line in mapped(made, max_range_m=float(np.nanquantile(depths, 0.3))).warnings)
    assert mapped(made).warnings == ()


def test_the_arrays_of_a_map_cannot_be_changed() -> None:
    made = make_world(slope)
    mapper = Mapper(made.rig)
    whole = mapper.process(made.pair, T_LM_NAVSB)
    cloud = whole.cloud
    for array in (
        *(getattr(cloud, name) for name in COLUMNS),
        whole.random_sigma,
        whole.disparity_px,
        whole.pixel_status,
        whole.T_lm_left.rotation,
        whole.T_lm_left.translation,
        mapper.fuse([whole]).random_sigma,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 1


def test_the_call_of_a_set_returns_the_map_of_both_calls() -> None:
    one, other = (make_world(hills, noise_seed=seed) for seed in (1, 2))
    mapper = Mapper(one.rig)
    fused = mapper.map([PosedStereoPair(item.pair, T_LM_NAVSB) for item in (one, other)])
    maps = [mapper.process(item.pair, T_LM_NAVSB) for item in (one, other)]
    expected = mapper.fuse(maps)
    assert fused.cloud.to_structured().tobytes() == expected.cloud.to_structured().tobytes()
    assert fused.statistics == expected.statistics


@pytest.mark.slow
@pytest.mark.shared
def test_development_ground(shared_data: Path) -> None:
    panorama = panorama_of(open_source(shared_data / "dev-nav"))
    rig, items = panorama.rig, list(panorama.pairs())
    mapper = Mapper(rig, MappingConfig())
    maps, singles = [], []
    for index, item in enumerate(items):
        result = mapper.process(item.pair, item.T_lm_navsb, index)
        cloud, truth = result.cloud, item.truth
        distance = np.linalg.norm(truth - (item.T_lm_navsb @ rig.T_sb_left).translation, axis=-1)
        error = np.linalg.norm(cloud.xyz - truth[cloud.v, cloud.u], axis=1)
        near = distance[cloud.v, cloud.u] < 4.0
        far = (distance[cloud.v, cloud.u] >= 4.0) & (distance[cloud.v, cloud.u] < 10.0)
        assert (near | far).sum() > 0.94 * (distance < 10.0).sum()
        assert error[near].mean() < 4.5e-3
        assert error[near].mean() + 3.0 * error[near].std() < 22e-3
        assert error[far].mean() < 26e-3
        within = [(error[near | far] < m * result.random_sigma[near | far]).mean() for m in (1, 2, 3)]
        np.testing.assert_allclose(within, [0.683, 0.954, 0.997], atol=0.06)
        maps.append(result)
        singles.append(error[near | far].mean())
    fused_map = mapper.fuse(maps)
    hazard = hazard_accuracy(fused_map, [item.truth for item in items])
    assert hazard.hazards > 400
    assert hazard.precision > 0.95
    assert hazard.recall > 0.90
    fused = fused_map.cloud
    truth = np.stack([item.truth for item in items])[fused.pair, fused.v, fused.u]
    origin = np.stack([(item.T_lm_navsb @ rig.T_sb_left).translation for item in items])[fused.pair]
    inside = np.linalg.norm(truth - origin, axis=1) < 10.0
    assert np.linalg.norm(fused.xyz - truth, axis=1)[inside].mean() <= min(singles) * 1.02


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "density", "bad", "mean"), [("pair-teddy", 0.85, 0.032, 0.38), ("pair-motorcycle", 0.87, 0.037, 0.63)]
)
def test_real_pairs(shared_data: Path, name: str, density: float, bad: float, mean: float) -> None:
    """Against structured light, whatever the right camera sees of it."""
    panorama = panorama_of(open_source(shared_data / name))
    item, rig = next(iter(panorama.pairs())), panorama.rig
    result = Mapper(rig, MappingConfig()).process(item.pair, item.T_lm_navsb, 0)
    depth = (item.T_lm_navsb @ rig.T_sb_left).inverse().apply(item.truth)[..., 2]
    error = np.abs(result.disparity_px - rig.fx * rig.baseline_m / depth)[np.isfinite(depth)]
    known = error[np.isfinite(error)]
    assert len(known) > density * len(error)
    assert (known > 2.0).mean() < bad
    assert known.mean() < mean


@pytest.mark.parametrize(("name", "density"), [("spirit-1", 0.73), ("spirit-5", 0.77)])
def test_mars(name: str, density: float) -> None:
    """A pair of Spirit: as dense as the page says, and the ground ahead of the lander is a plane at height 0."""
    panorama = panorama_of(open_source(SAMPLE / name))
    item = next(iter(panorama.pairs()))
    cloud = Mapper(panorama.rig).process(item.pair, item.T_lm_navsb, 0).cloud
    assert np.count_nonzero(cloud.u >= 56) > density * 200 * 256
    height = cloud.xyz[cloud.v < 75, 2]
    assert abs(np.median(height)) < 0.01
    assert np.percentile(np.abs(height), 80) < 0.06
    deck = cloud.xyz[cloud.v > 150, 2]
    assert 0.2 < np.median(deck) < 0.7
