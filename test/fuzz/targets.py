"""What is fuzzed: for each format the valid file, its mutations, and the commands or readers that take it."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

import mutations as m
import numpy as np
from execution import Command, Target, run_command
from message_mutations import MCAP, SQLITE
from world import KINDS, SCORE

from sfr_loc_map.inputs import parse_json
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.localisation.estimate import PoseEstimate, TrackingState
from sfr_loc_map.pipeline.localisation_session import LocalisationSession, PoseFile

from made_scene import LOC_RIG, T_RB_LOCSB, loc_pair  # isort: skip


def _localise(source: str) -> Command:
    return ("localise", f"{{w}}/{source}", "-o", "{o}/t.csv", "--stats", "{o}/s.csv", "--start", "truth")


def _map(source: str) -> Command:
    return ("map", f"{{w}}/{source}", "-o", "{o}/c.ply")


def _convert(source: str, target: str) -> Command:
    return ("convert", f"{{w}}/{source}", f"{{o}}/{target}")


def _bag_uses(name: str) -> tuple[Command, ...]:
    bag = f"{name}/bag{Path(name).suffix}"
    return (
        *(_localise(name), _localise(bag), _convert(name, "t.csv"), _convert(bag, "folder"), _convert(bag, "b.db3")),
        *(("doctor", f"{{w}}/{name}"), ("score", "{w}/estimate.csv", f"{{w}}/{name}"), _map(bag)),
        ("perturb", f"{{w}}/{bag}", "{o}/p", "--fault", "noisy"),
    )


def _cloud(name: str) -> Command:
    return ("score", f"{{w}}/{name}", "{w}/panorama")


def _trajectory_uses(name: str) -> tuple[Command, ...]:
    place = f"{{w}}/{name}"
    scores = (("score", place, "{w}/truth.csv", *SCORE[3:]), ("score", "{w}/truth.csv", place, *SCORE[3:]))
    return (*scores, ("doctor", place, "{w}/truth.csv"), _convert(name, "t.tum"), _convert(name, "t.mcap"))


def check_estimate(estimate: PoseEstimate, farthest_m: float) -> None:
    """Raise an `ArithmeticError` if the pose or covariance of an estimate is absurd."""
    position, covariance = estimate.T_ds_rb.translation, estimate.covariance
    if not (np.isfinite(position).all() and np.abs(position).max() < farthest_m and np.isfinite(covariance).all()):
        raise ArithmeticError(f"{estimate.state} at {position} with variances {np.diag(covariance)}")
    if estimate.state is not TrackingState.LOST and np.linalg.eigvalsh(covariance)[0] < -1e-9 * np.trace(covariance):
        raise ArithmeticError(f"{estimate.state} with a covariance that is none: {np.linalg.eigvalsh(covariance)}")


def resume(path: Path) -> None:
    """Start at a kept pose as a node does, and process two pairs."""
    file = PoseFile(path, 1e12)
    file.check()
    session = LocalisationSession(LocalisationConfig(), file)
    session.set_rig(LOC_RIG)
    for index in range(2):
        pair = loc_pair(index)
        estimate = session.localiser_at(pair.stamp_ns, T_RB_LOCSB).process(pair)
        session.accept(estimate)
        check_estimate(estimate, 1.1e9)


def plan_simulation(path: Path) -> None:
    """Read a scenario as `sfr simulate` does, up to where images are rendered."""
    from sfr_loc_map.cli.simulate import _flat
    from sfr_loc_map.config import build, load_yaml
    from sfr_loc_map.simulation.config import SimulationConfig
    from sfr_loc_map.simulation.drive import Plan

    Plan.make(build(SimulationConfig, _flat(load_yaml(path)), origin=str(path)))


def run_arguments(path: Path) -> None:
    """Run commands whose inputs have hostile names; what they are called is in the file."""
    try:
        names = parse_json(path.read_text("utf-8", "surrogatepass"))
    except ValueError:
        names = path.read_text("utf-8", "replace")[:200]
    words = [word if isinstance(word, str) else repr(word) for word in (names if isinstance(names, list) else [names])]
    words = (words + ["x"] * 3)[:3]
    world, out = path.parent, path.parent.with_name("out")
    named = world / "named"
    named.mkdir(exist_ok=True)
    for old in named.iterdir():
        old.unlink()
    with suppress(OSError, ValueError):  # a name that no file can have
        (named / words[0]).write_text("no trajectory")
    for command in (
        ("score", str(named / words[0]), "{w}/truth.csv"),
        ("score", *SCORE[1:3], "--condition", words[1]),
        ("convert", "{w}/bag.mcap", "{o}/x.csv", "--remap", words[2]),
        ("localise", words[0], "-o", "{o}/t.csv"),
        ("map", "{w}/panorama", "-o", "{o}/c.ply", "--config", words[1]),
        ("compare", words[0], words[1]),
        (words[2],),
    ):
        code = run_command(command, world, out)
        if code not in (0, 1, 2, 3):
            raise RuntimeError(f"exit code {code} of {command[0]}")


T = m.TEXT + m.BYTES
_RUN = (_localise("A-0"), _convert("A-0", "t.tum"), _convert("A-0", "f"))
_REPORTS = tuple(("report", "{w}/score.json", "-o", f"{{o}}/x.{kind}") for kind in ("html", "md", "csv"))
_COMPARISONS = (
    ("compare", "{w}/score.json", "{w}/score2.json", "--html", "{o}/x.html"),
    ("compare", "{w}/score2.json", "{w}/score.json"),
)
_ROS1 = (_localise("ros1.bag"), _convert("ros1.bag", "f"), ("doctor", "{w}/ros1.bag"), _map("ros1.bag"))
_TRUTH = (_localise("drive"), ("score", "{w}/estimate.csv", "{w}/drive"), _convert("drive", "t.csv"))
_RIG = (_localise("drive"), _convert("drive", "f"), _convert("drive", "b.mcap"))
_TIMED = (*SCORE, "--target", "LEON", "--target-timing", "{w}/stats.csv")
_EUROC = "euroc/mav0"
TARGETS = (
    Target("rig.json", "drive/rig.json", m.JSON, _RIG),
    Target("rig.json of mapping", "panorama/rig.json", m.JSON, (_map("panorama"), _convert("panorama", "b.mcap"))),
    Target("pairs.csv", "drive/pairs.csv", T, (_localise("drive"), _convert("drive", "b.mcap"))),
    Target("pairs.csv of mapping", "panorama/pairs.csv", T, (_map("panorama"), _convert("panorama", "f"))),
    Target("groundtruth.csv", "drive/groundtruth.csv", T, _TRUTH),
    Target("trajectory csv", "estimate.csv", T, _trajectory_uses("estimate.csv")),
    Target("TUM", "estimate.tum", T, _trajectory_uses("estimate.tum")),
    Target("KITTI poses", "estimate.kitti", T, _trajectory_uses("estimate.kitti")),
    Target("KITTI stamps", "estimate.times.txt", T, _trajectory_uses("estimate.kitti")),
    Target("EuRoC poses", "estimate.euroc.csv", T, _trajectory_uses("estimate.euroc.csv")),
    Target("evo result", "evo.zip", m.BYTES, _trajectory_uses("evo.zip")),
    Target("KITTI calib.txt", "kitti/calib.txt", T, (_localise("kitti"), _convert("kitti", "b.mcap"))),
    Target("KITTI times.txt", "kitti/times.txt", T, (_localise("kitti"), _convert("kitti", "f"))),
    Target("KITTI poses.txt", "kitti/poses.txt", T, (_localise("kitti"), _convert("kitti", "t.csv"))),
    Target("EuRoC sensor.yaml", f"{_EUROC}/cam0/sensor.yaml", m.YAML[4:] + m.TEXT, (_localise("euroc"),)),
    Target("EuRoC data.csv", f"{_EUROC}/cam1/data.csv", T, (_localise("euroc"), _convert("euroc", "f"))),
    Target(
        "EuRoC truth",
        f"{_EUROC}/state_groundtruth_estimate0/data.csv",
        T,
        (_localise("euroc"), _convert("euroc", "t.tum")),
    ),
    Target("MADMAX truth", "A-0/ground_truth/gt_6DoF_gnss_and_imu.csv", T, _RUN),
    Target("MADMAX camera", "calibration/camera_rect_left_info.txt", m.YAML[4:] + m.TEXT, _RUN),
    Target("MADMAX transform", "calibration/tf__camera_left_to_camera_right.csv", T, _RUN),
    Target("Katwijk calibration", "LocCam_calibstruct.mat", m.BYTES, (_convert("Part1", "f"),)),
    Target("LuSNAR truth", "Moon_1/gt.txt", T, (_convert("Moon_1", "t.tum"),)),
    Target("PNG", "drive/left/000000.png", m.PNG, (_localise("drive"), _convert("drive", "b.mcap"))),
    *(
        Target(
            kind.upper(),
            f"drive-{kind}/left/000000.{kind}",
            m.JPEG if kind == "jpg" else m.IMAGE,
            (_localise(f"drive-{kind}"), _convert(f"drive-{kind}", "b.mcap")),
            readable=kind in ("jpg", "pgm", "ppm", "bmp"),
        )
        for kind in KINDS
    ),
    Target(
        "truth .npy",
        "panorama/truth/000000.npy",
        m.NPY,
        (_map("panorama"), _cloud("cloud.ply"), _convert("panorama", "f")),
    ),
    Target("NPZ", "cloud.npz", m.NPZ, (_cloud("cloud.npz"),)),
    Target("PLY", "cloud.ply", m.CLOUD, (_cloud("cloud.ply"),)),
    Target("PCD", "cloud.pcd", m.CLOUD, (_cloud("cloud.pcd"),)),
    Target("LAS", "cloud.las", m.BYTES, (_cloud("cloud.las"), _convert("cloud.las", "x.dem.npz"))),
    Target("LAZ", "cloud.laz", m.BYTES, (_cloud("cloud.laz"), _convert("cloud.laz", "x.tif"))),
    Target("PCD of text", "text.pcd", m.CLOUD + m.TEXT, (_cloud("text.pcd"),)),
    Target("mcap", "bag.mcap/bag.mcap", MCAP, _bag_uses("bag.mcap")),
    Target("mcap of JPEG", "jpeg.mcap/bag.mcap", MCAP, (_localise("jpeg.mcap"), _convert("jpeg.mcap/bag.mcap", "f"))),
    Target("ROS 1 bag", "ros1.bag", m.BYTES, _ROS1),
    Target("sqlite3", "bag.db3/bag.db3", SQLITE, _bag_uses("bag.db3")),
    Target("metadata.yaml", "bag.mcap/metadata.yaml", m.YAML, _bag_uses("bag.mcap")),
    Target(
        "localisation config",
        "localisation.yaml",
        m.YAML,
        ((*_localise("drive"), "--config", "{w}/localisation.yaml"),),
    ),
    Target("mapping config", "mapping.yaml", m.YAML, ((*_map("panorama"), "--config", "{w}/mapping.yaml"),)),
    Target("limits", "limits_example.yaml", m.YAML, ((*SCORE, "--limits", "{w}/limits_example.yaml"),)),
    Target("stats csv", "stats.csv", T, ((*SCORE, "--stats", "{w}/stats.csv"),)),
    Target("target timing", "stats.csv", T, (_TIMED,)),
    Target("score JSON", "score.json", m.JSON, (*_REPORTS, *_COMPARISONS)),
    Target("resume file", "resume.json", m.JSON, (resume,)),
    Target("scenario", "scenario.yaml", m.YAML, (plan_simulation,)),
    Target("arguments", "arguments.json", (m.json_tree,), (run_arguments,)),
)


def all_targets() -> dict[str, Target]:
    """Return all targets by name; those of ROS messages where ROS can be imported."""
    targets = list(TARGETS)
    try:
        from message_targets import MESSAGE_TARGETS
    except ImportError as error:
        print(f"ROS messages are left out: {error}", file=sys.stderr)
    else:
        targets += MESSAGE_TARGETS
    return {target.name: target for target in targets}
