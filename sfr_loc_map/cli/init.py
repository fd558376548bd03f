"""`sfr init`: a configuration and limits to begin with."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from sfr_loc_map.atomic import write_text
from sfr_loc_map.cli.app import app, examples, propose
from sfr_loc_map.cli.options import CalibrationOption, OverwriteOption, RemapOption, SectionsOption, sections_of
from sfr_loc_map.cli.output import check_outputs, make_folder, say
from sfr_loc_map.config import to_yaml_lines
from sfr_loc_map.errors import FailedVerdictError
from sfr_loc_map.localisation.config import LocalisationConfig
from sfr_loc_map.mapping.config import MappingConfig


@app.command(epilog=examples("sfr init my_rover/", "sfr init my_rover/ --from drive.mcap --calibration camchain.yaml"))
def init(
    folder: Annotated[Path, Argument(metavar="DIR", help="Folder for the files; created if it does not exist.")] = Path(
        "."
    ),
    source: Annotated[
        Path | None, Option("--from", metavar="SRC", help="Recording that DIR/sfr.yaml describes.")
    ] = None,
    calibration: CalibrationOption = None,
    settings: SectionsOption = None,
    remap: RemapOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Write a commented configuration and limits to begin with: DIR/configuration.yaml and DIR/limits.yaml.

    Each parameter is listed with its description, unit, range and default. sfr replay, localise and map take the
    configuration as it is (--config), sfr score and replay the limits (--limits).

    With --from it is DIR/sfr.yaml: how SRC is read, each line with what it was inferred from. Exit 1 if something is
    missing that only you know.
    """
    if source is not None:
        sections = sections_of(None, calibration, settings, remap)
        _init_from(source, folder, sections, (source, calibration), overwrite=overwrite)
        return
    from sfr_loc_map.metrics.judging.limits_template import limits_text

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
    write_text(limits_text(), limits)
    say(f"configuration: {configuration}")
    say(f"limits: {limits}")
    words = ("sfr", "replay", "SRC", "--start", "truth", "--config", configuration, "--limits", limits, "--out", "out/")
    propose(*words, why="SRC: a bag or folder of yours; sfr info SRC says what it lacks")


def _init_from(
    source: Path, folder: Path, sections: dict[str, Any], inputs: Iterable[Path | None], *, overwrite: bool
) -> None:
    """Write the configuration that is inferred from a source, and limits; report what is missing."""
    from sfr_loc_map.io.source_config import NAME
    from sfr_loc_map.metrics.judging.limits_template import CONDITION, active_limits, is_edited, limits_text
    from sfr_loc_map.source_setup.proposal import propose_config

    path, limits = folder / NAME, folder / "limits.yaml"
    if folder.is_dir():
        check_outputs(path, inputs=inputs, overwrite=overwrite)
    found = propose_config(source, sections, path)
    make_folder(folder, "name")
    if "limits" not in found.sections:
        kept = limits.exists() and is_edited(limits.read_text(encoding="utf-8", errors="replace"))
        found.sections["limits"] = limits.name
        found.reasons["limits"] = "it was there, and is kept" if kept else "placeholders: write those of your document"
        if not kept:
            conditions = found.sections.get("conditions") or [CONDITION]
            active = active_limits(
                has_attitude=found.has_attitude is not False, has_height=found.has_height, has_tilt=found.has_tilt
            )
            write_text(limits_text(conditions[0], active), limits)
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
