"""What is fuzzed: for each format the valid file, its mutations, and the commands or readers that take it."""

from __future__ import annotations

import sys
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


def _convert(source: str, *targets: str) -> list[Command]:
    return [("convert", f"{{w}}/{source}", f"{{o}}/{target}") for target in targets]


def _drive(source: str, *targets: str) -> tuple[Command, ...]:
    """Return that a drive is localised and converted to files."""
    return (_localise(source), *_convert(source, *targets))


def _bag(name: str) -> tuple[Command, ...]:
    bag = f"{name}/bag{Path(name).suffix}"
    return (
        *(*_drive(name, "t.csv"), *_drive(bag, "folder", "b.db3"), _map(bag), ("doctor", f"{{w}}/{name}")),
        ("score", "{w}/estimate.csv", f"{{w}}/{name}"),
        ("perturb", f"{{w}}/{bag}", "{o}/p", "--fault", "noisy"),
    )


def _cloud(name: str, *targets: str) -> tuple[Command, ...]:
    return (("score", f"{{w}}/{name}", "{w}/panorama"), *_convert(name, *targets))


def _trajectory(name: str) -> tuple[Command, ...]:
    place = f"{{w}}/{name}"
    scores = (("score", place, "{w}/truth.csv", *SCORE[3:]), ("score", "{w}/truth.csv", place, *SCORE[3:]))
    return (*scores, ("doctor", place, "{w}/truth.csv"), *_convert(name, "t.tum", "t.mcap"))


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
        words = parse_json(path.read_text("utf-8", "surrogatepass"))
    except ValueError:
        words = path.read_text("utf-8", "replace")[:200]
    words = [word if isinstance(word, str) else repr(word) for word in (words if isinstance(words, list) else [words])]
    first, second, third = (words + ["x"] * 3)[:3]
    world, out = path.parent, path.parent.with_name("out")
    for command in (
        ("score", *SCORE[1:3], "--condition", second),
        ("convert", "{w}/bag.mcap", "{o}/x.csv", "--remap", third),
        ("localise", first, "-o", "{o}/t.csv"),
        ("map", "{w}/panorama", "-o", "{o}/c.ply", "--config", second),
        ("compare", first, second),
        (third,),
    ):
        code = run_command(command, world, out)
        if code not in (0, 1, 2, 3):
            raise RuntimeError(f"exit code {code} of {command[0]}")


T = m.TEXT + m.BYTES
YAML_TEXT = m.YAML[3:]  # what is YAML for others only is no tree
_PANORAMA = (_map("panorama"), *_convert("panorama", "b.mcap", "f"))
_EUROC = "euroc/mav0"
_SCORES = (
    *(("report", "{w}/score.json", "-o", f"{{o}}/x.{kind}") for kind in ("html", "md", "csv")),
    ("compare", "{w}/score.json", "{w}/score2.json", "--html", "{o}/x.html"),
    ("compare", "{w}/score2.json", "{w}/score.json"),
)
TARGETS = (
    Target("rig.json", "drive/rig.json", m.JSON, _drive("drive", "f", "b.mcap")),
    Target("rig.json of mapping", "panorama/rig.json", m.JSON, _PANORAMA),
    Target("pairs.csv", "drive/pairs.csv", T, _drive("drive", "b.mcap")),
    Target("pairs.csv of mapping", "panorama/pairs.csv", T, _PANORAMA),
    Target(
        "groundtruth.csv", "drive/groundtruth.csv", T, (*_drive("drive", "t.csv"), ("score", SCORE[1], "{w}/drive"))
    ),
    Target("trajectory csv", "estimate.csv", T, _trajectory("estimate.csv")),
    Target("TUM", "estimate.tum", T, _trajectory("estimate.tum")),
    Target("KITTI poses", "estimate.kitti", T, _trajectory("estimate.kitti")),
    Target("KITTI stamps", "estimate.times.txt", T, _trajectory("estimate.kitti")),
    Target("EuRoC poses", "estimate.euroc.csv", T, _trajectory("estimate.euroc.csv")),
    Target("evo result", "evo.zip", m.BYTES, _trajectory("evo.zip")),
    Target("KITTI calib.txt", "kitti/calib.txt", T, _drive("kitti", "b.mcap")),
    Target("KITTI times.txt", "kitti/times.txt", T, _drive("kitti", "f")),
    Target("KITTI poses.txt", "kitti/poses.txt", T, _drive("kitti", "t.csv")),
    Target("EuRoC sensor.yaml", f"{_EUROC}/cam0/sensor.yaml", YAML_TEXT, _drive("euroc")),
    Target("EuRoC data.csv", f"{_EUROC}/cam1/data.csv", T, _drive("euroc", "f")),
    Target("EuRoC truth", f"{_EUROC}/state_groundtruth_estimate0/data.csv", T, _drive("euroc", "t.tum")),
    Target("PNG", "drive/left/000000.png", m.PNG, _drive("drive", "b.mcap")),
    *(
        Target(
            kind.upper(),
            f"drive-{kind}/left/000000.{kind}",
            m.JPEG if kind == "jpg" else m.IMAGE,
            _drive(f"drive-{kind}", "b.mcap"),
            readable=kind not in ("tiff", "webp"),
        )
        for kind in KINDS
    ),
    Target("truth .npy", "panorama/truth/000000.npy", m.NPY, (*_PANORAMA, *_cloud("cloud.ply"))),
    Target("NPZ", "cloud.npz", m.NPZ, _cloud("cloud.npz", "x.dem.npz", "x.tif")),
    Target("PLY", "cloud.ply", m.CLOUD, _cloud("cloud.ply")),
    Target("PCD", "cloud.pcd", m.CLOUD, _cloud("cloud.pcd")),
    Target("PCD of text", "text.pcd", m.CLOUD + m.TEXT, _cloud("text.pcd")),
    Target("mcap", "bag.mcap/bag.mcap", MCAP, _bag("bag.mcap")),
    Target("mcap of JPEG", "jpeg.mcap/bag.mcap", MCAP, _drive("jpeg.mcap", "f")),
    Target("ROS 1 bag", "ros1.bag", m.BYTES, (*_drive("ros1.bag", "f"), ("doctor", "{w}/ros1.bag"), _map("ros1.bag"))),
    Target("sqlite3", "bag.db3/bag.db3", SQLITE, _bag("bag.db3")),
    Target("metadata.yaml", "bag.mcap/metadata.yaml", m.YAML, _bag("bag.mcap")),
    Target(
        "localisation config",
        "localisation.yaml",
        m.YAML,
        ((*_localise("drive"), "--config", "{w}/localisation.yaml"),),
    ),
    Target("mapping config", "mapping.yaml", m.YAML, ((*_map("panorama"), "--config", "{w}/mapping.yaml"),)),
    Target("limits", "limits_example.yaml", m.YAML, ((*SCORE, "--limits", "{w}/limits_example.yaml"),)),
    Target("stats csv", "stats.csv", T, ((*SCORE, "--stats", "{w}/stats.csv"),)),
    Target("target timing", "stats.csv", T, ((*SCORE, "--target", "LEON", "--target-timing", "{w}/stats.csv"),)),
    Target("score JSON", "score.json", m.JSON, _SCORES),
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
