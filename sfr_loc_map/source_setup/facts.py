"""Facts about a source: pairs, rate, image size, extrinsics, truth, gaps, and the topics of a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.inputs import NS_PER_S
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.bag.files import is_bag
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.report.tables import Cell, Column, Table
from sfr_loc_map.source_setup.topic_guess import seen_topics

GAP = 1.5  #: Longest time between two pairs, in periods, that is not a gap.


def facts_of(path: Path, config: SourceConfig) -> dict[str, Any]:
    """Return the facts of a source by their names on the screen and in JSON.

    A source that cannot be opened with this configuration has the entry "cannot be read".
    """
    facts: dict[str, Any] = {"source": str(path)}
    try:
        facts |= _facts_of_pairs(open_source(path, config))
    except SfrError as error:
        facts["cannot be read"] = str(error)
    facts["topics"] = _topics(path, config) if is_bag(path) else []
    return facts


def facts_tables(facts: dict[str, Any]) -> list[Table]:
    """Return the facts, and the topics of a bag, as tables."""
    topics: list[dict[str, Any]] = facts["topics"]
    shown = {name: f"{value:.6g}" if isinstance(value, float) else value for name, value in facts.items()}
    del shown["topics"]
    rows = [(Cell.head(name), Cell("none" if value is None else str(value))) for name, value in shown.items()]
    tables = [Table("source", "Source", (Column("", words=True), Column("", words=True)), tuple(rows))]
    if topics:
        columns = tuple(Column(name, words=True) for name in topics[0])
        cells = tuple(tuple(Cell(str(value)) for value in topic.values()) for topic in topics)
        tables.append(Table("topics", "Topics", columns, cells))
    return tables


def _topics(path: Path, config: SourceConfig) -> list[dict[str, Any]]:
    names = {topic.strip("/"): name for topic, name in config.remap.items()}
    names[config.truth.source.strip("/")] = "truth"
    return [
        {
            "name": topic.name,
            "type": topic.msgtype,
            "messages": topic.count,
            "frame": topic.frame,
            "size": " x ".join(map(str, topic.size)) if all(topic.size) else "",
            "read as": names.get(topic.name.strip("/"), ""),
        }
        for topic in sorted(seen_topics(Bag(path)), key=lambda topic: topic.name)
    ]


def _facts_of_pairs(source: Source) -> dict[str, Any]:
    """Return the facts of an opened source by their names on the screen and in JSON."""
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
        if source.calibration:
            facts["calibration"] = source.calibration
        mounted = source.loc.rig.T_rb_sb
        facts["extrinsics"] = "not known" if mounted is None else f"LOCSB at {mounted.translation.round(4).tolist()} m"
        truth = source.loc.ground_truth
        facts["truth"] = "none"
        if truth is not None and len(truth):
            length_m = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1).sum()
            kind = "poses" if truth.has_attitude else "positions"
            facts["truth"] = f"{len(truth)} {kind}, {length_m:.3f} m long, {getattr(truth, 'read_from', '')}".rstrip(
                ", "
            )
    if source.nav is not None:
        facts["mapping"] = f"{len(source.nav)} pairs, {_camera(source.nav.rig)}"
    return facts


def _camera(rig: StereoRig) -> str:
    return f"{rig.width} x {rig.height}, focal length {rig.fx:.6g} px, baseline {rig.baseline_m:.6g} m"
