"""Updates of an invented run for the live page: poses with truth, calls, health, score, images and maps."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator

import numpy as np

from sfr_loc_map.calls.call_record import CallRecord
from sfr_loc_map.geometry.plausibility import LOST_VARIANCE
from sfr_loc_map.io.truth.config import TrackedBodyConfig
from sfr_loc_map.live.media import grid_of_cloud, with_layer
from sfr_loc_map.live.state import LiveState
from sfr_loc_map.live.tracked_images import TrackedImages
from sfr_loc_map.live.updates import (
    ElevationSample,
    GraphNodes,
    ImageSample,
    ImageStamp,
    NodeCall,
    PoseSample,
    PublishedScore,
    Status,
    Track,
    Update,
)
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_types import Level, StatusKind
from sfr_loc_map.metrics.config import ScoreConfig
from sfr_loc_map.metrics.judging.limits_file import parse_limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_json
from sfr_loc_map.scoring.live.live_score import LiveRun
from sfr_loc_map.scoring.live.monitor_score import MonitorScore
from sfr_loc_map.suite_names import SIDES

TIMES = {"latency_transport_s": 0.004}
NODES = ("localisation_node", "mapping_node", "monitor_node")
STEP_NS = NS_PER_S // 10
LIMITS = {
    "minimum_count": 5,
    "minimum_independent": 1,
    "trajectory": [
        {"condition": "distance=5", "position_mean_plus_3sigma_m": 0.1, "heading_mean_plus_3sigma_deg": 0.01}
    ],
    "map": {"coverage_min": 0.8},
    "timing": {"localisation_p95_s": 1.0},
}


def pose_pair(number: int, received_s: float, *, lost: bool = False) -> tuple[PoseSample, PoseSample]:
    """Return truth and estimate of a frame on an arc with steps of 0.1 m; the estimate is scaled by 0.4 %."""
    angle, stamp_ns = 0.005 * number, (number + 1) * STEP_NS
    truth = (20.0 * math.sin(angle), 20.0 * (1 - math.cos(angle)), 0.0)
    wobble = 0.002 * math.sin(0.7 * number)
    estimate = (truth[0] * 1.004 + wobble, truth[1] * 1.004 - wobble, wobble)
    covariance = np.eye(6) * (LOST_VARIANCE if lost else 1e-4)
    (true_quat, quat) = ((0.0, 0.0, math.sin(a / 2), math.cos(a / 2)) for a in (angle, angle + 0.05 * wobble))
    return (
        PoseSample(Track.TRUTH, stamp_ns, truth, true_quat, received_s, None),
        PoseSample(Track.ESTIMATE, stamp_ns, estimate, quat, received_s, covariance),
    )


def poses(count: int, begin_s: float) -> Iterator[PoseSample]:
    """Yield truth and estimates at 10 Hz."""
    for number in range(count):
        yield from pose_pair(number, begin_s + 0.1 * number)


def frame(number: int, now_s: float, *, lost: bool = False) -> list[Update]:
    """Return the poses of a frame and the stamp of its image."""
    return [ImageStamp("loc/left", (number + 1) * STEP_NS, now_s), *pose_pair(number, now_s, lost=lost)]


def scored(count: int, config: ScoreConfig | None = None) -> Score:
    """Return the score that the monitor publishes after the first poses."""
    on_a_plane = TrackedBodyConfig(unknown="none")
    score = MonitorScore(config or ScoreConfig(), parse_limits(LIMITS, "made"), on_a_plane)
    for pose in poses(count, 0.0):
        if pose.covariance is None:
            score.add_truth(pose.stamp_ns, pose.position, pose.quat_xyzw)
        else:
            score.add_estimate(pose.stamp_ns, pose.position, pose.quat_xyzw, pose.covariance)
            score.add_call(
                CallRecord(
                    pose.stamp_ns,
                    0.035,
                    "tracking",
                    peak_rss_bytes=412_000_000,
                    above_idle_bytes=90_000_000,
                    statistics=TIMES,
                )
            )
    return score.result(LiveRun(details=False))


def report(count: int, received_s: float) -> PublishedScore:
    """Return the published form of this score."""
    return PublishedScore(to_json(scored(count)), received_s)


def call(number: int, received_s: float, state: str = "tracking", reason: str = "") -> NodeCall:
    times = {"latency_transport_s": 0.004, "latency_receive_to_publish_s": 0.041}
    record = CallRecord((number + 1) * STEP_NS, 0.0351, state, peak_rss_bytes=412_000_000, reason=reason, times=times)
    return NodeCall("localisation_node", record, received_s)


def health(node: str, received_s: float, level: Level = Level.OK, message: str = "tracking") -> Status:
    values = {
        "lifecycle": "active",
        "received_messages_hz": "20.0",
        "processed_hz": "10.0",
        "waiting": "0",
        "resident_memory_bytes": "400000000",
        "latency_transport_p95_s": "0.0042",
        "dropped_in_transport": "3" if level else "0",
        "dropped_unpaired": "0",
    }
    return Status(node, StatusKind.HEALTH, level, message, values, received_s)


def tracks() -> np.ndarray:
    """Return twenty feature tracks `(20, 5)`; one track has no position in the present image."""
    rows = np.random.default_rng(6).uniform(20.0, 220.0, (20, 5)).astype(np.float32)
    rows[:, 4] = np.linspace(0.0, 1.0, 20)
    rows[3] = [np.nan, np.nan, 50.0, 60.0, np.nan]
    return rows


def images(stamp_ns: int, now_s: float) -> list[ImageSample]:
    """Return the images of both localisation cameras; the left image has its tracks."""
    v, u = np.mgrid[:240, :320]
    pixels = (127 + 60 * np.sin(u / 9.0) + 60 * np.cos(v / 7.0)).astype(np.uint8)
    shown: list[ImageSample] = []
    feed = TrackedImages(shown.append)
    feed.add_tracks(stamp_ns - 1, tracks())  # from now on images wait for their tracks
    for side in SIDES:
        feed.add_image(f"loc/{side}", stamp_ns, pixels, now_s)
    feed.add_tracks(stamp_ns, tracks())
    return shown


def grid_with_hazard(stamp_ns: int, now_s: float, count: int = 60_000) -> ElevationSample:
    """Return the elevation grid of a random cloud, with a hazard layer."""
    rng = np.random.default_rng(5)
    xy = rng.uniform((-1.0, -6.0), (12.0, 6.0), (count, 2))
    points = np.column_stack([xy, 0.2 * np.sin(xy[:, 0]) + 0.1 * np.cos(2 * xy[:, 1])])
    sigma = 1e-3 * np.hypot(*xy.T) ** 2
    error = np.abs(rng.normal(0.0, sigma + 1e-6))
    grid = grid_of_cloud(stamp_ns, points, sigma, now_s, error)
    assert grid is not None
    return with_layer(grid, "hazard", np.full(grid.layers.shape[:2], 40.0))


def fill(state: LiveState, frames: int = 60) -> None:
    """Put all updates of a run that ends now into a state, with a score that has every table."""
    from helpers.made_scores import whole_score

    now_s = time.time()
    for node in NODES:
        state.put(health(node, now_s))
    for number in range(frames):
        for update in frame(number, now_s):
            state.put(update)
        state.put(call(number, now_s))
    state.put(PublishedScore(to_json(whole_score(100, 48, 2)), now_s))
    state.put(GraphNodes(frozenset(NODES), now_s, {"localisation/odometry": 0}))
    for media in (*images(STEP_NS, now_s), grid_with_hazard(STEP_NS, now_s)):
        state.put(media)


def updates(count: int, begin_s: float) -> Iterator[Update]:
    """Yield the updates of a run that ends at `begin_s + 0.1 * count`."""
    end_s = begin_s + 0.1 * count
    yield from poses(count, begin_s)
    yield call(count - 1, end_s)
    yield health("localisation_node", end_s)
    yield health("mapping_node", end_s, Level.WARN, "stereo pairs without a pose")
    yield health("monitor_node", end_s, Level.OK, "scoring")
    yield GraphNodes(frozenset(NODES), end_s, {"localisation/odometry": 2})
    yield report(count, end_s)
