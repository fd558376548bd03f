"""`sfr doctor`: the blocking issues of a bag or a graph, or the convention mismatch that explains a disagreement."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import (
    ConfigOption,
    IntakeOptions,
    JsonOption,
    LenientOption,
    OverwriteOption,
    checked_namespace,
    require_ros,
)
from sfr_loc_map.cli.output import STANDARD_OUTPUT, check_outputs, progress_bar, say, show
from sfr_loc_map.cli.verdict import not_judged
from sfr_loc_map.config import read_sections
from sfr_loc_map.errors import ConfigError, FailedVerdictError, InputError, SfrError
from sfr_loc_map.io.atomic import write_text
from sfr_loc_map.io.bag_files import is_bag
from sfr_loc_map.metrics.config import ScoreConfig

if TYPE_CHECKING:
    from sfr_loc_map.doctor.examination import Finding
    from sfr_loc_map.doctor.observation import Observation
    from sfr_loc_map.io.source_config import SourceConfig

SHOWN_HYPOTHESES = 5


@app.command(
    epilog=examples(
        "sfr doctor data/",
        "sfr doctor recording.mcap --remap /cam0/image:=loc/left/image_rect",
        "sfr doctor --graph --namespace rover1 --seconds 5",
        "sfr doctor estimate.csv data/",
    ),
    hint="sfr replay SRC --start truth --out DIR    # through the nodes, scored",
)
def doctor(
    intake: IntakeOptions,
    subject: Annotated[
        Path | None, Argument(metavar="SRC|EST", help="Any source; or an estimated trajectory: TUM, csv, bag.")
    ] = None,
    truth: Annotated[
        Path | None, Argument(metavar="TRUTH", help="With EST: trajectory, bag or data set folder.")
    ] = None,
    graph: Annotated[bool, Option(help="Look at the running ROS graph.")] = False,
    namespace: Annotated[
        str, Option(metavar="NS", callback=checked_namespace, help="Namespace of the rover (--graph).")
    ] = "",
    seconds: Annotated[
        float, Option(min=0.1, max=600.0, metavar="S", help="How long messages are watched, after the first (--graph).")
    ] = 3.0,
    fix: Annotated[bool, Option(help="Write what the source seems to be into its sfr.yaml, then look again.")] = False,
    config: ConfigOption = None,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
    lenient: LenientOption = False,
) -> None:
    """Name the blocking issues of a source or of the running graph (--graph), each with its fix; exit 1 for any.

    With EST and TRUTH: find the convention mismatch that explains how an estimate disagrees with the truth; exit 1
    if there is one, 3 if they have no stamps in common. The disagreement is the mean error of position per distance
    travelled and of attitude in radians, re-based at many starts.
    """
    if graph != (subject is None) or (graph and truth is not None):
        raise ConfigError("nothing to examine: give SRC, or EST and TRUTH, or --graph")
    check_outputs(json_path, overwrite=overwrite)
    if subject is not None and truth is not None:
        _diagnose(subject, truth, json_path, lenient=lenient)
        return
    from sfr_loc_map.doctor.examination import examine

    path, sections, given = intake.read(subject, config)
    if subject is None:
        require_ros("doctor --graph")
        from sfr_loc_map.nodes.graph import GraphObserver

        extrinsics_given = given.extrinsics.transform() is not None
        with GraphObserver({topic: name for name, topic in given.topics.items()}) as observer:
            seen = observer.observe(seconds, namespace, extrinsics_given=extrinsics_given)
        _show(seen, examine(seen), json_path, ["sfr", "record", "drive"])
        return
    if not subject.exists():
        raise InputError(f"there is no '{subject}': give a data set folder, a bag, KITTI or EuRoC, or --graph")
    if fix:
        from sfr_loc_map.doctor.source_proposal import propose_config
        from sfr_loc_map.io.source_config import NAME

        # into the configuration that was read, else a new one
        place = path or (subject if subject.is_dir() else subject.parent) / NAME
        found = propose_config(subject, sections, place, {} if path is None else read_sections(path))
        write_text(found.text(), place)
        say(f"configuration: {place}{'' if path is None else ', written again: its values stand'}", err=True)
        for text in (*found.missing, *found.remarks):
            say(f"{'missing' if text in found.missing else 'remark'}: {text}", err=True)
        given = found.config
    seen = _observe(subject, given)
    findings = examine(seen)
    of_config = [] if config is None else ["--config", str(config)]
    if not fix and any(finding.is_blocking for finding in findings):
        words = ["sfr", "doctor", str(subject), "--fix", *of_config, *intake.words()]
        findings = _with_fix(subject, sections, path, findings, words)
    start = ["--start", "truth"] if seen.truth_has_attitude else []
    _show(seen, findings, json_path, ["sfr", "replay", str(subject), *of_config, *start, "--out", "out"])


def _observe(source: Path, config: SourceConfig) -> Observation:
    from sfr_loc_map.doctor.observation import observe_bag, observe_source

    if is_bag(source) and replace(config, path=None, remap={}, extrinsics=type(config.extrinsics)()) == type(config)():
        return observe_bag(source, config)
    with progress_bar("pairs") as bar:
        task = bar.add_task("reading", total=None)
        return observe_source(source, config, lambda: bar.advance(task))


def _with_fix(
    source: Path, sections: dict[str, Any], path: Path | None, findings: list[Finding], words: list[str]
) -> list[Finding]:
    """Return findings with the command that ends each which a proposed configuration does end: it is tried."""
    from sfr_loc_map.doctor.examination import examine
    from sfr_loc_map.doctor.source_proposal import propose_config

    try:
        found = propose_config(source, sections, path)
        left = {finding.cause for finding in examine(_observe(source, found.config)) if finding.is_blocking}
    except SfrError:
        return findings
    command = shlex.join(words)
    added = {name: values for name, values in found.sections.items() if values != sections.get(name) and values}
    if added.keys() - {"conditions"} == {"topics"}:  # these alone will do
        remaps = [word for name, topic in added["topics"].items() for word in ("--remap", f"{topic}:={name}")]
        command += f"; for a command alone: {shlex.join(remaps)}"
    missing = "".join(f"; still missing: {text}" for text in found.missing)
    return [
        replace(finding, fix=command + missing) if finding.is_blocking and finding.cause not in left else finding
        for finding in findings
    ]


def _show(seen: Observation, findings: list[Finding], json_path: str | None, after: list[str]) -> None:
    """Show findings, and the command that is useful after them; raise FailedVerdictError if there is a blocking one."""
    stops = sum(finding.is_blocking for finding in findings)
    fix = next((item.fix.partition(";")[0] for item in findings if item.fix.startswith("sfr doctor")), "")
    if fix:
        propose(fix, why="writes the sfr.yaml of the source")
    elif stops:
        propose("...", why="again, after the fix")
    else:
        propose(*after, why="inputs and outputs into a bag" if seen.live else "through the nodes, scored")
    content = {"subject": seen.subject, "stops": stops, "findings": [finding.as_dict() for finding in findings]}
    show(content, json_path, ())
    if json_path != STANDARD_OUTPUT:
        for finding in findings:
            say(f"{'BLOCKING' if finding.is_blocking else 'warning '}  {finding.where}: {finding.text}")
            say(f"          fix: {finding.fix}")
        if not findings:
            say(f"{seen.subject}: no blocking issue")
    if stops:
        raise FailedVerdictError(f"{stops} blocking issue{'s' * (stops > 1)} on {seen.subject}")


def _diagnose(estimate: Path, truth: Path, json_path: str | None, *, lenient: bool) -> None:
    """Show what explains the disagreement of estimate and truth; raise FailedVerdictError if something does."""
    from sfr_loc_map.metrics.convention import MIN_POSES
    from sfr_loc_map.report.tables import Cell, Column, Table
    from sfr_loc_map.scoring.score_run import diagnose_files

    diagnosis = diagnose_files(estimate, truth, ScoreConfig())
    rows = [(Cell.head("as it is"), Cell.number(diagnosis.disagreement, undefined="no stamp in common"), Cell(""))]
    rows += [
        (Cell.head(f"without: {item.mismatch}"), Cell.number(item.disagreement), Cell(item.setting))
        for item in diagnosis.hypotheses[:SHOWN_HYPOTHESES]
    ]
    columns = (Column("convention", words=True), Column("disagreement"), Column("corrected by", words=True))
    show(diagnosis, json_path, [Table("conventions", "Estimate against truth", columns, tuple(rows))])
    if diagnosis.found is not None:
        if json_path != STANDARD_OUTPUT:
            say(diagnosis.found.sentence)
            if diagnosis.found.setting:
                say(f"sfr score ... --convention {diagnosis.found.setting} corrects it")
        raise FailedVerdictError(f"estimate and truth contradict each other by convention: {diagnosis.found.mismatch}")
    if diagnosis.disagreement is None:
        not_judged([f"'{estimate}' and '{truth}' have fewer than {MIN_POSES} stamps in common"], lenient=lenient)
    elif json_path != STANDARD_OUTPUT:
        say("no single convention mismatch explains the disagreement, if there is any")
