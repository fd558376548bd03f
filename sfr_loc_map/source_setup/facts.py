"""Facts about a source: pairs, rate, image size, extrinsics, truth, gaps, and the topics of a bag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sfr_loc_map.errors import SfrError
from sfr_loc_map.geometry.arrays import IntArray
from sfr_loc_map.geometry.stereo import StereoRig
from sfr_loc_map.geometry.trajectory import Truth
from sfr_loc_map.io.bag.bag import Bag
from sfr_loc_map.io.bag.topic_names import TOPICS_READ
from sfr_loc_map.io.registry import open_source
from sfr_loc_map.io.sequence import Source
from sfr_loc_map.io.source_config import SourceConfig
from sfr_loc_map.io.source_format import is_bag
from sfr_loc_map.message_stamps import NS_PER_S
from sfr_loc_map.message_text import counted
from sfr_loc_map.source_setup.seen_topics import seen_topics
from sfr_loc_map.tables.model import Cell, Column, Table

GAP = 1.5  #: Longest time between two pairs, in periods, that is not a gap.


@dataclass(frozen=True, slots=True)
class SourceFacts:
    """The facts about a source."""

    values: Mapping[str, Any]  #: Facts by their names on the screen and in JSON.
    topics: Sequence[Mapping[str, Any]]  #: Topics of a bag, each with its properties by name; empty without a bag.
    problem: str = ""  #: Why the source cannot be opened with its configuration; empty if it can be opened.

    @property
    def json_values(self) -> dict[str, Any]:
        """All facts by their names in JSON."""
        problem = {"cannot be read": self.problem} if self.problem else {}
        return {**self.values, **problem, "topics": list(self.topics)}


def facts_of(path: Path, config: SourceConfig) -> SourceFacts:
    """Return the facts about a source; if it cannot be opened, its name, its topics and the problem."""
    values: dict[str, Any] = {"source": str(path)}
    topics: list[dict[str, Any]] = []
    try:
        if is_bag(path):
            topics = _topics(Bag(path), config)
        values |= _facts_of_pairs(open_source(path, config))
    except SfrError as error:
        return SourceFacts(values, topics, str(error))
    return SourceFacts(values, topics)


def facts_tables(facts: Mapping[str, Any]) -> list[Table]:
    """Return facts by their names in JSON, and the topics of a bag, as tables."""
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


def _topics(bag: Bag, config: SourceConfig) -> list[dict[str, Any]]:
    """Return the topics of a bag, each with the name under which it is read.

    If the configuration names topics wrongly, the topics are listed without the name under which they are read.
    `SourceFacts.problem` then states the reason.
    """
    names = dict[str, str]()
    with suppress(SfrError):
        renamed = bag.renamed(config.topics)
        names = {topic: name for name in TOPICS_READ for topic in renamed.matches(name)}
        if config.truth.source:
            names |= dict.fromkeys(renamed.matches(config.truth.source), "truth")
    return [
        {
            "name": topic.name,
            "type": topic.msgtype,
            "messages": topic.count,
            "frame": topic.frame,
            "size": " x ".join(map(str, topic.size)) if all(topic.size) else "",
            "read as": names.get(topic.name, ""),
        }
        for topic in sorted(seen_topics(bag), key=lambda topic: topic.name)
    ]


def _facts_of_pairs(source: Source) -> dict[str, Any]:
    """Return the facts of an opened source by their names on the screen and in JSON."""
    facts: dict[str, Any] = {"format": source.format}
    if source.loc is not None:
        stamps_ns = np.asarray(source.loc.stamps_ns, np.int64)
        facts["drive"] = f"{counted(len(stamps_ns), 'pair')}, {_camera(source.loc.rig)}"
        facts |= _facts_of_stamps(stamps_ns)
        if source.calibration:
            facts["calibration"] = source.calibration
        T_rb_sb = source.loc.rig.T_rb_sb
        facts["extrinsics"] = "not known" if T_rb_sb is None else f"LOCSB at {T_rb_sb.translation.round(4).tolist()} m"
        facts["truth"] = _truth(source.loc.ground_truth)
    if source.nav is not None:
        facts["mapping"] = f"{counted(len(source.nav), 'pair')}, {_camera(source.nav.rig)}"
    return facts


def _facts_of_stamps(stamps_ns: IntArray) -> dict[str, Any]:
    """Return duration, rate and gaps of stamps; rate and longest gap are None for fewer than two stamps."""
    steps_s = np.diff(stamps_ns) / NS_PER_S
    if not len(steps_s):
        return {"duration_s": 0.0, "rate_hz": None, "gaps": 0, "longest_gap_s": None}
    period_s = float(np.median(steps_s))
    return {
        "duration_s": float(steps_s.sum()),
        "rate_hz": 1.0 / period_s if period_s else None,
        "gaps": int((steps_s > GAP * period_s).sum()),
        "longest_gap_s": float(steps_s.max()),
    }


def _truth(truth: Truth | None) -> str:
    if truth is None or not len(truth):
        return "none"
    length_m = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1).sum()
    kind = "poses" if truth.has_attitude else "positions"
    origin = f", {truth.read_from}" if truth.read_from else ""
    return f"{len(truth)} {kind}, {length_m:.3f} m long{origin}"


def _camera(rig: StereoRig) -> str:
    return f"{rig.width} x {rig.height}, focal length {rig.fx:.6g} px, baseline {rig.baseline_m:.6g} m"
