"""Opens what can be played: the folder of a replay, a bag of a run, any source with images."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from sfr_loc_map.errors import InputError
from sfr_loc_map.geometry.cloud import PointCloud
from sfr_loc_map.geometry.trajectory import Trajectory
from sfr_loc_map.inputs import parse_json, read_table, read_text
from sfr_loc_map.io.bag import ODOMETRY, Bag
from sfr_loc_map.io.bag_files import is_bag
from sfr_loc_map.io.bag_poses import GROUND_TRUTH, read_trajectory
from sfr_loc_map.io.cloud_file import load_cloud
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.live.node_view import CALL_TIMES
from sfr_loc_map.live.playback.recording import MAPPING_NODE, RecordedMap, RecordedStatus, Recording, place
from sfr_loc_map.live.report_view import MAX_REPORT_CHARACTERS
from sfr_loc_map.live.updates import Status, StatusKind
from sfr_loc_map.localisation.estimate import TrackingState
from sfr_loc_map.metrics.association import Estimates
from sfr_loc_map.metrics.config import MappingState
from sfr_loc_map.metrics.score_json import SCHEMA
from sfr_loc_map.pipeline.call_stats import STATISTIC, STEP_NAMES, TaskRecord, call_of, load_call_stats
from sfr_loc_map.pipeline.replay import ReplayFiles
from sfr_loc_map.pipeline.scoring import load_estimates, load_truth

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
LOCALISATION_NODE = "localisation_node"
LEVELS = {TrackingState.DEGRADED.value: 1, TrackingState.LOST.value: 2}
KEPT = frozenset({"task", "stamp_ns", "state", "reason", "peak_rss_bytes", *CALL_TIMES})
"""Values of a call that are shown; the others are for its score."""


def open_recording(path: Path, truth: Path | None = None) -> Recording:
    """Return what is recorded in a folder of `sfr replay --out`, a bag or a data set.

    Args:
        path: Where it is.
        truth: Source with the truth and the images of a replay; None: the one that its report names.

    Raises:
        InputError: If there is nothing to play, or it is broken.
    """
    files = ReplayFiles(path)
    if path.is_dir() and any(file.is_file() for file in (files.estimate, files.cloud, files.report)):
        return _replayed(files, truth)
    return _bag(path, truth) if is_bag(path) else _source(path, truth)


def _replayed(files: ReplayFiles, truth: Path | None) -> Recording:
    """Return a finished replay; where its source is gone the figures are those of its report."""
    report = _report(files.report)
    place_of = truth if truth is not None else _source_of(report)
    source = None if place_of is None else open_source(place_of)
    stats = [load_call_stats(files.stats)] if files.stats.is_file() else []
    calls = list(_rows(files.stats)) if stats else []
    estimates = load_estimates(files.estimate, stats) if files.estimate.is_file() else None
    cloud = load_cloud(files.cloud).cloud if files.cloud.is_file() else None
    if cloud is not None:
        calls = [_of_cloud(item, cloud) for item in calls]
    found = _truth_of(source)
    text = "" if found is not None or (source is not None and source.nav is not None) else _text(files.report)
    return _recording(files.folder, (estimates, found), _statuses(calls), source, (cloud, text))


def _bag(path: Path, truth: Path | None) -> Recording:
    """Return a bag: with estimates that of a run, else the images and the truth of a drive."""
    bag = Bag(path)
    has_estimates = bag.find("localisation/odometry", ODOMETRY) is not None
    try:
        source = open_source(path if truth is None else truth)
    except InputError:
        if not has_estimates:
            raise
        source = None  # a recording without images
    estimates = load_estimates(path) if has_estimates else None
    true_poses = load_truth(truth) if truth is not None else read_trajectory(bag, GROUND_TRUTH)
    return _recording(path, (estimates, true_poses), list(_diagnostics(bag)), source, (None, ""))


def _source(path: Path, truth: Path | None) -> Recording:
    source = open_source(path)
    true_poses = load_truth(truth) if truth is not None else _truth_of(source)
    return _recording(path, (None, true_poses), [], source, (None, ""))


Spoken = tuple[int | None, Status, TaskRecord | None]
"""Stamp, None for that of what came before; status; the call that it describes."""


def _recording(
    path: Path,
    poses: tuple[Estimates | None, Trajectory | None],
    spoken: list[Spoken],
    source: Source | None,
    made: tuple[PointCloud | None, str],
) -> Recording:
    """Return the recording with its time line.

    Raises:
        InputError: If nothing is in it.
    """
    estimates, truth = poses
    cloud, report = made
    drive, panorama = _stamps_of_poses(estimates, truth), list((cloud and cloud.pair_stamps_ns) or ())
    drive += _stamps_of_calls(spoken, of_map=False)
    panorama += _stamps_of_calls(spoken, of_map=True)
    if source is not None:
        drive += _ends(source.loc)
        panorama += _ends(source.nav)
    if not drive and not panorama and not report:
        raise InputError(f"'{path}' holds nothing to play: give a bag, the folder of sfr replay --out, or a data set")
    begin = (min(drive, default=0), min(panorama, default=0))
    ends = [place(max(stamps, default=0), first) for stamps, first in zip((drive, panorama), begin, strict=True)]
    return Recording(
        title=path.name or str(path),
        estimates=estimates,
        truth=truth,
        statuses=list(_placed(spoken, begin)),
        source=source,
        map=None if cloud is None else RecordedMap.of(cloud, source),
        report=report,
        begin_ns=begin,
        end_s=max(ends),
    )


def _stamps_of_poses(estimates: Estimates | None, truth: Trajectory | None) -> list[int]:
    """Return the first and the last stamp of both."""
    tracks = [track for track in (None if estimates is None else estimates.trajectory, truth) if track is not None]
    return [int(stamp) for track in tracks if len(track) for stamp in (track.stamps_ns.min(), track.stamps_ns.max())]


def _stamps_of_calls(spoken: list[Spoken], *, of_map: bool) -> list[int]:
    return [stamp for stamp, status, _ in spoken if stamp is not None and (status.node == MAPPING_NODE) == of_map]


def _placed(spoken: list[Spoken], begin: tuple[int, int]) -> Iterator[RecordedStatus]:
    """Give each status its place; health has no stamp of the drive and stands where it was recorded.

    A run of a map and a drive has two clocks: statuses keep their order on the time line all the same.
    """
    latest = {False: 0.0, True: 0.0}
    found = []
    for stamp_ns, status, record in spoken:
        is_map = status.node == MAPPING_NODE
        if stamp_ns is not None:
            latest[is_map] = place(stamp_ns, begin[is_map])
        at_s = latest[is_map] if stamp_ns is not None else max(latest.values())
        found.append(RecordedStatus(at_s, status, None if record is None else record.record))
    yield from sorted(found, key=lambda item: item.at_s)


def _ends(part: Any) -> list[int]:  # noqa: ANN401 - files and bags know their stamps without their images
    stamps: tuple[int, ...] = getattr(part, "stamps_ns", ())
    return [stamps[0], stamps[-1]] if stamps else []


def _truth_of(source: Source | None) -> Trajectory | None:
    truth = None if source is None or source.loc is None else source.loc.ground_truth
    return truth if truth is not None and len(truth) else None


def _text(file: Path) -> str:
    try:
        return read_text(file, MAX_REPORT_CHARACTERS)
    except FileNotFoundError:
        return ""
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot read the report '{file}': {error}; replay again") from error


def _report(file: Path) -> Mapping[str, Any]:
    text = _text(file)
    try:
        content = parse_json(text) if text else {}
    except ValueError as error:
        raise InputError(f"report '{file}' is no JSON ({error}); replay again") from error
    return content if isinstance(content, dict) and content.get("schema") == SCHEMA else {}


def _source_of(report: Mapping[str, Any]) -> Path | None:
    """Return the source that a replay was made of, None where the report does not name it or it is gone."""
    provenance = report.get("provenance")
    inputs = provenance.get("inputs") if isinstance(provenance, dict) else None
    for role in ("map_truth", "truth"):
        item = inputs.get(role) if isinstance(inputs, dict) else None
        if not isinstance(item, dict) or not isinstance(item.get("path"), str):
            continue
        path = Path(item["path"])
        if path.name == "groundtruth.csv":
            path = path.parent.parent if path.parent.name == "loc" else path.parent
        if path.exists():
            return path
    return None


def _rows(stats: Path) -> Iterator[dict[str, str]]:
    """Yield the calls of statistics as the values of a status."""
    text = read_table(stats).decode("utf-8-sig")
    for row in csv.DictReader(io.StringIO(text, newline="")):
        yield _values_of({name: text for name, text in row.items() if isinstance(name, str) and text})


def _values_of(row: Mapping[str, str]) -> dict[str, str]:
    state, steps = row.get("state", ""), [row.get(name, "") for name in STEP_NAMES]
    return {
        **{name: text for name, text in row.items() if name in KEPT or name == "above_idle_bytes"},
        **{STATISTIC + name: text for name, text in row.items() if _is_number(text)},
        "task": "mapping" if state in set(MappingState) else "localisation",
        "processing_time_s": row.get("processing_time_s", "0"),
        "state": state,
        "step": " ".join(steps) if all(steps) else "",
    }


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _of_cloud(values: dict[str, str], cloud: PointCloud) -> dict[str, str]:
    """Let a fusion say what the file of the cloud says of it."""
    if values["state"] != MappingState.FUSED or cloud.fused is None:
        return values
    return values | {f"{STATISTIC}fused": str(float(cloud.fused))}


def _statuses(calls: list[dict[str, str]]) -> list[Spoken]:
    found: list[Spoken] = []
    for values in calls:
        record = call_of(values)
        if record is None:
            continue
        node = MAPPING_NODE if record.task == "mapping" else LOCALISATION_NODE
        found.append((record.record.stamp_ns, _call_status(node, values), record))
    return found


def _call_status(node: str, values: Mapping[str, str]) -> Status:
    state, reason = values.get("state", ""), values.get("reason", "")
    shown = {name: text for name, text in values.items() if name in KEPT}
    message = f"{state}: {reason}" if reason else state
    return Status(node, StatusKind.CALL, LEVELS.get(state, 0), message, shown, 0.0)


def _diagnostics(bag: Bag) -> Iterator[Spoken]:
    """Yield what the nodes said of themselves in a run."""
    topic = bag.find("diagnostics", DIAGNOSTICS)
    if topic is None:
        return
    kinds = {kind.value for kind in StatusKind}
    for _, _, message in bag.messages([topic]):
        for status in message.status:
            name, _, kind = status.name.partition(": ")
            if kind not in kinds:
                continue
            values = {pair.key: pair.value for pair in status.values}
            record = call_of(values) if kind == StatusKind.CALL else None
            shown = {key: text for key, text in values.items() if not key.startswith(STATISTIC) and key != "step"}
            node = PurePosixPath("/" + name).name
            told = Status(node, StatusKind(kind), int(status.level), status.message, shown, 0.0)
            yield (None if record is None else record.record.stamp_ns), told, record
