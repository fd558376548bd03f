"""`sfr info`: what a source holds, on one screen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import ConfigOption, IntakeOptions, JsonOption, OverwriteOption, SourceArgument
from sfr_loc_map.cli.output import check_outputs, show
from sfr_loc_map.errors import SfrError
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.bag_files import is_bag

if TYPE_CHECKING:
    from sfr_loc_map.geometry.stereo import StereoRig
    from sfr_loc_map.io.sequence import Source

GAP = 1.5  #: Periods between two pairs beyond which something is missing.


@app.command(epilog=examples("sfr info drive.mcap", "sfr info data/ --json -"))
def info(
    intake: IntakeOptions,
    source: SourceArgument,
    config: ConfigOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Show what a source holds: pairs, rate, size, topics, calibration, extrinsics, truth, duration, gaps."""
    from sfr_loc_map.doctor.source_proposal import seen_topics
    from sfr_loc_map.io.bag import Bag
    from sfr_loc_map.io.registry import open_source
    from sfr_loc_map.report.tables import Cell, Column, Table

    check_outputs(json_path, overwrite=overwrite)
    path, _, how = intake.read(source, config)
    facts: dict[str, Any] = {"source": str(source), "configuration": None if path is None else str(path)}
    try:
        facts |= _facts(open_source(source, how))
        propose("sfr", "doctor", source, why="what it lacks")
    except SfrError as error:
        if not is_bag(source):
            raise
        facts["cannot be read"] = str(error)
        propose("sfr", "init", "DIR", "--from", source, why="a configuration for it, with what it was inferred from")
    facts["topics"] = []
    if is_bag(source):
        names = {topic.strip("/"): name for topic, name in how.remap.items()} | {how.truth.source.strip("/"): "truth"}
        facts["topics"] = [
            {
                "name": topic.name,
                "type": topic.msgtype,
                "messages": topic.count,
                "frame": topic.frame,
                "size": " x ".join(map(str, topic.size)) if all(topic.size) else "",
                "read as": names.get(topic.name.strip("/"), ""),
            }
            for topic in sorted(seen_topics(Bag(source)), key=lambda topic: topic.name)
        ]
    shown = {name: f"{value:.6g}" if isinstance(value, float) else value for name, value in facts.items()}
    del shown["topics"]
    rows = [(Cell.head(name), Cell("none" if value is None else str(value))) for name, value in shown.items()]
    tables = [Table("source", "Source", (Column("", words=True), Column("", words=True)), tuple(rows))]
    if facts["topics"]:
        columns = tuple(Column(name, words=True) for name in facts["topics"][0])
        cells = tuple(tuple(Cell(str(value)) for value in topic.values()) for topic in facts["topics"])
        tables.append(Table("topics", "Topics", columns, cells))
    show(facts, json_path, tables)


def _facts(source: Source) -> dict[str, Any]:
    """Return what is known of an opened source, by what it is called on the screen and in JSON."""
    import numpy as np

    facts: dict[str, Any] = {"format": source.format}
    if source.loc is not None:
        stamps = np.asarray(source.loc.stamps_ns, np.int64)
        gaps_s = np.diff(stamps) / NS_PER_S
        period_s = float(np.median(gaps_s)) if len(gaps_s) else None
        facts["drive"] = f"{len(stamps)} pairs, {_camera(source.loc.rig)}"
        facts["duration_s"] = float(gaps_s.sum())
        facts["rate_hz"] = None if not period_s else 1.0 / period_s
        facts["gaps"] = 0 if period_s is None else int((gaps_s > GAP * period_s).sum())
        facts["longest_gap_s"] = float(gaps_s.max()) if len(gaps_s) else None
        mounted = source.loc.rig.T_rb_sb
        facts["extrinsics"] = "not known" if mounted is None else f"LOCSB at {mounted.translation.round(4).tolist()} m"
        truth = source.loc.ground_truth
        facts["truth"] = "none"
        if truth is not None and len(truth):
            length_m = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1).sum()
            kind = "poses" if getattr(truth, "has_attitude", True) else "positions"
            facts["truth"] = f"{len(truth)} {kind}, {length_m:.3f} m long, {getattr(truth, 'read_from', '')}".rstrip(
                ", "
            )
    if source.nav is not None:
        facts["mapping"] = f"{len(source.nav)} pairs, {_camera(source.nav.rig)}"
    return facts


def _camera(rig: StereoRig) -> str:
    return f"{rig.width} x {rig.height}, focal length {rig.fx:.6g} px, baseline {rig.baseline_m:.6g} m"
