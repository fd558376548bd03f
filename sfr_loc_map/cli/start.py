"""`sfr init`: a configuration and limits to begin with; `sfr methods`: what `--method` knows by name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import IntakeOptions, JsonOption, OverwriteOption
from sfr_loc_map.cli.output import check_outputs, make_folder, say, show
from sfr_loc_map.config import to_yaml_lines
from sfr_loc_map.errors import FailedVerdictError
from sfr_loc_map.io.atomic import write_text
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig

LIMITS_HEAD = """\
# Limits: PLACEHOLDERS, replace them by those of your own document. Upper bounds, except coverage_min; the name of a
# figure ends in its unit. A line that begins with '#' is not in force. Taken by sfr score and sfr replay (--limits).
# Exit code 1 if one is missed, 3 if one cannot be judged.

# Fewer values than this are not enough data for a verdict. (2 or more)
minimum_count: 2

# Errors at the end of sub-trajectories: one entry for each condition.
trajectory:
  # distance=METRES, time=SECONDS, frames=NUMBER, displacement=METRES, turn=DEGREES, or several: distance=5,time=10
  - condition: {condition}
    # id: LOC-12
    # text: 3D position error over 5 m
    # certain: true    (a pass needs the whole 95 % interval within the limit)"""
CONDITION = "distance=5"
POSES = "position_mean_plus_3sigma_m", "attitude_mean_plus_3sigma_deg", "heading_mean_plus_3sigma_deg"
POSITIONS = "position_mean_plus_3sigma_m", "chord_mean_plus_3sigma_m"  #: What can be judged by a truth of positions.
LIMITS_MEANINGS = {
    "completeness": "Shares: what the estimate or the cloud leaves out, or cannot be judged",
    "map": "Of a map; a score without one then says: not enough data",
    "timing": "Time of a call on this host, which says nothing of a flight computer",
    "memory": "Resident memory of the process during a call, on this host",
    "target": "Calls that were measured on the target (--target, --target-timing)",
}


@app.command(epilog=examples("sfr init my_rover/", "sfr init my_rover/ --from drive.mcap --calibration camchain.yaml"))
def init(
    intake: IntakeOptions,
    folder: Annotated[Path, Argument(metavar="DIR", help="Folder for the files; made if it is not there.")] = Path("."),
    source: Annotated[
        Path | None, Option("--from", metavar="SRC", help="Recording that DIR/sfr.yaml shall be for.")
    ] = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write a commented configuration and limits to begin with: DIR/configuration.yaml and DIR/limits.yaml.

    Each parameter stands there with its description, unit, range and default. sfr replay, localise and map take the
    configuration as it is (--config), sfr score and replay the limits (--limits).

    With --from it is DIR/sfr.yaml: how SRC is read, each line with what it was inferred from. Exit 1 if something is
    missing that only you know.
    """
    if source is not None:
        _init_from(source, folder, intake, overwrite=overwrite)
        return
    make_folder(folder, "name")
    configuration, limits = folder / "configuration.yaml", folder / "limits.yaml"
    check_outputs(configuration, limits, overwrite=overwrite)
    lines = [
        "# Parameters of localiser and mapper: [unit] (smallest .. largest), at their defaults. Change what you need,",
        "# delete what you do not: a parameter that is missing has its default. Taken by",
        "#   sfr localise SRC -o T.csv --config FILE, sfr map SRC -o C.ply --config FILE, sfr replay SRC --config FILE",
        "# The nodes have more: config/localisation.yaml, config/mapping.yaml and config/monitor.yaml of the package.",
    ]
    for name, config_type in (("localisation", LocalisationConfig), ("mapping", MappingConfig)):
        lines += ["", f"{name}:", *to_yaml_lines(config_type, "  ")]
    write_text("\n".join(lines) + "\n", configuration)
    write_text(_limits_text(), limits)
    say(f"configuration: {configuration}")
    say(f"limits: {limits}")
    words = ("sfr", "replay", "SRC", "--start", "truth", "--config", configuration, "--limits", limits, "--out", "out/")
    propose(*words, why="SRC: a bag or folder of yours; sfr doctor SRC says what it lacks")


def _init_from(source: Path, folder: Path, intake: IntakeOptions, *, overwrite: bool) -> None:
    from sfr_loc_map.doctor.source_proposal import propose_config
    from sfr_loc_map.io.source_config import NAME

    path, limits = folder / NAME, folder / "limits.yaml"
    if folder.is_dir():
        check_outputs(path, overwrite=overwrite)
    found = propose_config(source, intake.sections(None), path)
    make_folder(folder, "name")
    if "limits" not in found.sections:
        there = limits.read_text(encoding="utf-8", errors="replace") if limits.exists() else ""
        condition = (re.findall("- condition: (.*)", there) or [""])[0]
        kept = limits.exists() and there not in (_limits_text(condition, active) for active in (POSES, POSITIONS))
        found.sections["limits"] = limits.name
        found.reasons["limits"] = "it was there, and is kept" if kept else "placeholders: write those of your document"
        if not kept:
            conditions = found.sections.get("conditions") or [CONDITION]
            write_text(_limits_text(conditions[0], POSITIONS if found.has_attitude is False else POSES), limits)
        say(f"limits: {limits} ({found.reasons['limits']})")
    write_text(found.text(), path)
    say(f"configuration: {path}")
    for text in found.remarks:
        say(f"remark: {text}", err=True)
    if found.missing:
        propose("..." if overwrite else "... --overwrite", why="with what is missing")
        raise FailedVerdictError(f"'{path}' is not complete: {'; '.join(found.missing)}")
    start = ("--start", "truth") if found.has_attitude else ()
    propose("sfr", "replay", source, "--config", path, *start, "--out", "out", why="through the nodes, scored")


@app.command(
    epilog=examples("sfr methods", "sfr methods --include-dir"),
    hint="sfr localise SRC -o T.csv --method NAME    # the same drive by another method",
)
def methods(
    include_dir: Annotated[bool, Option(help="Print the folder of sfr_candidate.h, and nothing else.")] = False,
    json_path: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """List the methods under test with their versions; a class or a C library needs no entry here."""
    from sfr_loc_map.methods.registry import header_folder, listed_methods
    from sfr_loc_map.report.tables import Cell, Column, Table

    if include_dir:
        say(str(header_folder()))
        return
    check_outputs(json_path, overwrite=overwrite)
    found = listed_methods()
    rows = tuple(tuple(Cell(text or "-") for text in item.values()) for item in found)
    columns = tuple(Column(title, words=True) for title in ("task", "method", "version", "kind", ""))
    show({"methods": found}, json_path, [Table("methods", "Methods", columns, rows)])


def _limits_text(condition: str = CONDITION, active: tuple[str, ...] = POSES) -> str:
    """Return a limits file: some of the trajectory in force, all others behind a '#', to be taken in."""
    from sfr_loc_map.metrics.limits import NAMES, LimitPart

    lines = [LIMITS_HEAD.replace("{condition}", condition)]
    for name in NAMES[LimitPart.TRAJECTORY]:
        lines.append(f"    {'' if name in active else '# '}{name}: {0.1 if name.endswith('_m') else 1.0}")
    for part, meaning in LIMITS_MEANINGS.items():
        lines += ["", f"# {meaning}.", f"# {part}:"]
        lines += [f"#   {name}: {1.0e9 if name.endswith('_bytes') else 0.5}" for name in NAMES[LimitPart(part)]]
    return "\n".join(lines) + "\n"
