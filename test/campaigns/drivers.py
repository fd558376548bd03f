"""Localisation from two camera drivers in separate processes, with jitter, various encodings, raw or rectified images.

The node has default parameters except for topic names, and `input.rectify` for raw images. If tf2_msgs is installed,
the extrinsics follow from the driver's frames; otherwise they are parameters.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from numpy.typing import NDArray

from campaigns.camera_driver import ENCODINGS
from campaigns.own_domain import in_own_domain
from helpers import ROOT
from helpers.node_scenes import DRIVERS, params
from helpers.peer import Peer
from sfr_loc_map.child_process import child_environment
from sfr_loc_map.io.calibration.projections import projection
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.message_stamps import stamp_of
from sfr_loc_map.ros.environment import start_ros
from sfr_loc_map.ros.messages import tf_message_type
from sfr_loc_map.ros.processes import Supervisor
from sfr_loc_map.ros.statuses import values_of
from sfr_loc_map.suite_names import SIDES

SECONDS = 8.0
JITTER_S = 0.008
MIN_SHARE = 0.95
DISTORTION = (-0.08, 0.02, 0.0005, -0.0005, 0.0)
TOPICS = {
    "zed": "/zed/zed_node/{side}/{name}",
    "realsense": "/camera/camera/{side}/{name}",
    "oak-d": "/oak/{side}/{name}",
}
LOST = 9999.0  #: Variance of a lost pose.
IDENTITY = params("T_rb_locsb.translation_m:=[0.0, 0.0, 0.0]", "T_rb_locsb.quat_xyzw:=[0.0, 0.0, 0.0, 1.0]")


@dataclass(frozen=True)
class Case:
    """The configuration of the cameras."""

    driver: str
    rate_hz: float
    size: int
    is_raw: bool
    encoding: str

    def __str__(self) -> str:
        return (
            f"{self.encoding}, {self.rate_hz:g} Hz, {self.size}, {'raw' if self.is_raw else 'rectified'}, {self.driver}"
        )


@dataclass
class Found:
    """The result of a case."""

    case: Case
    sent: int
    localised: int
    late_s: float  #: 95 % quantile of the delay of the slower driver.
    length_error: float  #: Relative error of the path length.
    dropped: dict[str, int]  #: Dropped images by cause, as counted by the node.

    @property
    def share(self) -> float:
        return self.localised / self.sent

    @property
    def host_keeps_up(self) -> bool:
        """Whether the drivers were in time and the node was not overloaded."""
        return self.late_s < 0.5 / self.case.rate_hz and not self.dropped.get("overload")

    @property
    def problem(self) -> str:
        """The deviation from the expected result; empty if there is none, or if the host does not keep up."""
        if not self.host_keeps_up:
            return ""
        share = f"{self.share:.1%} of the pairs localised" if self.share < MIN_SHARE else ""
        error = f"the path is {self.length_error:.1%} too long" if abs(self.length_error) > 0.02 else ""
        return "; ".join(filter(None, (share, error)))


@dataclass(frozen=True)
class Images:
    """Image files and camera_info of both cameras, and the true positions `(N, 3)`."""

    files: dict[tuple[int, bool, str], Path]
    cameras: dict[tuple[int, bool, str], dict[str, Any]]
    positions: NDArray[np.float64]


def make_images(folder: Path, count: int, sizes: Sequence[int] = (512, 1024)) -> Images:
    """Scale the images of the sample, and write a second, distorted set of each size."""
    source = open_source(ROOT / "sample" / "sample.mcap").loc
    assert source is not None
    assert source.ground_truth is not None
    files, cameras, stamps = {}, {}, []
    stacks: dict[str, list[NDArray[np.uint8]]] = {side: [] for side in SIDES}
    for pair in source.pairs():
        if len(stamps) == count:
            break
        stamps.append(pair.stamp_ns)
        for side, image in zip(SIDES, (pair.left, pair.right), strict=True):
            stacks[side].append(image)
    for size, is_raw, side in product(sizes, (False, True), SIDES):
        scale = size / source.rig.width
        k = np.array(source.rig.camera_matrix, np.float64) * scale
        k[:2, 2] += 0.5 * (scale - 1.0)  # pixel centres are at integer coordinates
        k[2, 2] = 1.0
        p = projection(source.rig, side) * scale
        p[[2, 6, 10]] = k[0, 2], k[1, 2], 1.0
        grid = np.stack(np.meshgrid(np.arange(size), np.arange(size)), -1).reshape(-1, 1, 2).astype(np.float64)
        distortion = np.array(DISTORTION if is_raw else (0.0,) * 5)
        place = cv2.undistortPoints(grid, k, distortion, P=k).reshape(size, size, 2).astype(np.float32)
        key = size, is_raw, side
        files[key] = folder / f"{side}_{size}_{is_raw}.npy"
        stack = np.lib.format.open_memmap(files[key], "w+", np.uint8, (count, size, size))
        for index, image in enumerate(stacks[side]):
            scaled = cv2.resize(image, (size, size), interpolation=cv2.INTER_CUBIC) if scale != 1.0 else image
            stack[index] = cv2.remap(scaled, place, None, cv2.INTER_CUBIC) if is_raw else scaled
        matrices = {"k": k, "d": distortion, "r": np.eye(3), "p": p}
        cameras[key] = {name: value.reshape(-1).tolist() for name, value in matrices.items()}
    truth = source.ground_truth
    return Images(files, cameras, truth.positions[np.searchsorted(truth.stamps_ns, stamps)])


def run_case(case: Case, images: Images, folder: Path) -> Found:
    """Publish from two drivers to a node; return the number of localised pairs and the errors."""
    folder.mkdir()
    count = min(int(SECONDS * case.rate_hz), len(images.positions))
    image, words = "image_raw" if case.is_raw else "image_rect", ["--ros-args"]
    names = {}
    for side in SIDES:
        for name in (image, "camera_info"):
            names[side, name] = TOPICS[case.driver].format(side=side, name=name)
            words += ["-r", f"loc/{side}/{name}:={names[side, name]}"]
    words += params("input.rectify:=true") if case.is_raw else []
    words += [] if tf_message_type() else IDENTITY
    start_ros()
    odometry: dict[int, Odometry] = {}
    with Supervisor(folder) as supervisor, Peer() as peer:
        peer.node.create_subscription(
            Odometry, "localisation/odometry", lambda m: odometry.update({stamp_of(m): m}), 1000
        )
        diagnostics = peer.listen(DiagnosticArray, "/diagnostics")
        supervisor.start("localisation_node", words)
        peer.wait_until_known_to("/localisation_node")
        drivers = []
        for side in SIDES:
            key = case.size, case.is_raw, side
            settings = {
                "driver": case.driver, "side": side, "count": count, "rate_hz": case.rate_hz, "jitter_s": JITTER_S,
                "encoding": case.encoding, "images": str(images.files[key]), "camera": images.cameras[key],
                "topic": names[side, image], "info_topic": names[side, "camera_info"],
            }  # fmt: skip
            path = folder / f"{side}.json"
            path.write_text(json.dumps(settings))
            program = [sys.executable, "-m", "campaigns.camera_driver", str(path)]
            drivers.append(
                subprocess.Popen(
                    program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=child_environment()
                )
            )
        for driver in drivers:
            assert driver.stdout is not None
            assert driver.stdout.readline() == "ready\n"
        begin_ns = time.time_ns() + 5 * 10**8
        for driver in drivers:
            assert driver.stdin is not None
            driver.stdin.write(f"{begin_ns}\n")
            driver.stdin.flush()
        while any(driver.poll() is None for driver in drivers):
            peer.spin(0.1)
        before = -1
        while len(odometry) > before:  # queued pairs are still localised
            before = len(odometry)
            peer.spin(1.0)
        said = [json.loads(driver.stdout.read()) for driver in drivers if driver.stdout is not None]
    rclpy.shutdown()
    stamps = said[0]["stamps_ns"]  # the stamp of a pair is that of its left image
    good = [
        index for index, stamp in enumerate(stamps) if stamp in odometry and odometry[stamp].pose.covariance[0] < LOST
    ]
    places = [odometry[stamps[index]].pose.pose.position for index in good]
    path = np.array([[place.x, place.y, place.z] for place in places])
    true = images.positions[good]
    lengths = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in (path, true)]
    late_s = max(float(np.quantile(item["late_s"], 0.95)) for item in said)
    error = lengths[0] / lengths[1] - 1.0 if len(good) > 1 else float("nan")
    health = [values_of(status) for array in diagnostics for status in array.status if status.name.endswith(": health")]
    dropped = {
        name.removeprefix("dropped_"): int(health[-1][name]) for name in health[-1] if name.startswith("dropped_")
    }
    return Found(case, len(stamps), len(good), late_s, error, {name: n for name, n in dropped.items() if n})


def drive_pairs(folder: Path, encodings: Sequence[str] = tuple(ENCODINGS)) -> list[str]:
    """Run all cases, print each result and the table; return the deviations."""
    cases = [
        Case(driver, rate, size, raw, encoding)
        for number, (encoding, size, raw, rate) in enumerate(
            product(encodings, (512, 1024), (False, True), (10.0, 20.0))
        )
        for driver in [list(DRIVERS)[number % len(DRIVERS)]]
    ]
    images, found = make_images(folder, int(SECONDS * max(case.rate_hz for case in cases))), []
    print(f"extrinsics {'from /tf_static' if tf_message_type() else 'given: tf2_msgs is not installed'}")
    for number, case in enumerate(cases):
        one = run_case(case, images, folder / str(number))
        found.append(one)
        text = f"{case}: {one.localised} of {one.sent}, late {1e3 * one.late_s:.0f} ms, path {one.length_error:+.2%}"
        print(f"{text} {one.dropped or ''} {one.problem}", flush=True)
    columns = list(dict.fromkeys((c.size, c.is_raw, c.rate_hz) for c in cases))
    print("| encoding |", *(f"{s} {'raw' if raw else 'rect.'} {rate:g} Hz |" for s, raw, rate in columns))
    print("|" + "---|" * (1 + len(columns)))
    for encoding in encodings:
        of = {(o.case.size, o.case.is_raw, o.case.rate_hz): o for o in found if o.case.encoding == encoding}
        cells = (f"{100 * of[c].share:.0f}{'' if of[c].host_keeps_up else '*'}" for c in columns)
        print(f"| {encoding} | {' | '.join(cells)} |")
    return [f"{one.case}: {one.problem}" for one in found if one.problem]


def main(arguments: list[str]) -> int:
    """Localise from the drivers with the given encodings `[ENCODING ...]`, all by default."""
    return in_own_domain(lambda folder: drive_pairs(folder, tuple(arguments or ENCODINGS)))
