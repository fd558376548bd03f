"""`sfr score`: how good is a trajectory or a map, and does it meet the limits."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sfr_loc_map.cli.app import app
from sfr_loc_map.cli.common import ConditionOption
from sfr_loc_map.cli.output import check_output
from sfr_loc_map.errors import ConfigError, FailedVerdictError, MissingExtraError

if TYPE_CHECKING:
    from sfr_loc_map.metrics.config import ScoreConfig

LimitsOption = Annotated[Path | None, typer.Option("--limits", help="Limits (YAML); exit code 1 if one is missed.")]


@app.command()
def score(
    estimate: Annotated[
        Path, typer.Argument(metavar="EST", help="Trajectory (TUM, csv, bag) or cloud (.ply, .pcd, .npz).")
    ],
    truth: Annotated[
        Path, typer.Argument(metavar="TRUTH", help="Trajectory, bag or data set; for a cloud a source with truth.")
    ],
    condition: ConditionOption = None,
    spacing: Annotated[int, typer.Option(help="Frames from one start to the next.")] = 10,
    rebase: Annotated[str, typer.Option(help="Taken from the estimate at a start: pose or position.")] = "pose",
    limits: LimitsOption = None,
    stats: Annotated[
        list[Path] | None, typer.Option(help="CSV with the calls (time, memory, state, covariance); repeatable.")
    ] = None,
    target: Annotated[str | None, typer.Option(help="Name of the target that --target-timing was measured on.")] = None,
    target_timing: Annotated[
        Path | None, typer.Option(help="CSV with calls on the target: processing_time_s, state, peak_rss_bytes.")
    ] = None,
    associate: Annotated[str, typer.Option(help="Truth of an estimate: auto, match or interpolate.")] = "auto",
    max_gap: Annotated[float, typer.Option(help="Longest gap of the truth that is interpolated, s.")] = 1.0,
    scored_range: Annotated[
        tuple[float, float], typer.Option("--range", help="Ranges of the truth that count for coverage, m.")
    ] = (0.0, 10.0),
    fused: Annotated[
        bool | None, typer.Option("--fused/--not-fused", help="Whether the cloud is fused; found out if not given.")
    ] = None,
    json_path: Annotated[
        str | None, typer.Option("--json", metavar="F", help="Write the score as JSON; - for standard output.")
    ] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page with figures.")] = None,
) -> None:
    """Score an estimate against the truth."""
    from sfr_loc_map.config import build
    from sfr_loc_map.metrics.config import ScoreConfig
    from sfr_loc_map.metrics.limits import load_limits
    from sfr_loc_map.pipeline.scoring import ScoreInputs, score_files

    parsed_limits = load_limits(limits) if limits is not None else None
    values = {
        "trajectory.spacing": spacing,
        "trajectory.rebase": rebase,
        "trajectory.association.truth": associate,
        "trajectory.association.max_gap_s": max_gap,
        "map.scored_from_m": scored_range[0],
        "map.scored_to_m": scored_range[1],
    }
    if condition:
        values["trajectory.conditions"] = tuple(condition)
    config: ScoreConfig = build(ScoreConfig, values, origin="options")
    if (target is None) != (target_timing is None):
        raise ConfigError("'--target' and '--target-timing' belong together: give the name and the file")
    inputs = replace(ScoreInputs.of(estimate, truth, stats or ()), target=target_timing, target_name=target or "")
    check_output(Path(json_path) if json_path is not None and json_path != "-" else None)
    check_output(html, (".html", ".htm"))
    result = score_files(inputs, config, parsed_limits, fused=fused)
    present(result, json_path, html)


def present(result: dict[str, Any], json_path: str | None, html: Path | None) -> None:
    """Write and print a score.

    Raises:
        FailedVerdictError: If a limit was missed.
    """
    from sfr_loc_map.io.atomic import atomic_path
    from sfr_loc_map.metrics.results import failed, to_json

    if json_path == "-":
        sys.stdout.write(to_json(result))
    elif json_path is not None:
        with atomic_path(Path(json_path)) as temporary:
            temporary.write_text(to_json(result), encoding="utf-8")
    if html is not None:
        _write_page(result, html)
    if json_path != "-":
        from rich.console import Console

        console = Console()
        if not console.is_terminal:
            console = Console(width=120)
        for table in score_tables(result):
            console.print(table)
    for warning in result.get("warnings", []):
        print(f"sfr: warning: {warning}", file=sys.stderr)
    missed = failed(result)
    if missed:
        names = ", ".join(f"{item['metric']} {item['value']:.6g} > {item['limit']:g}" for item in missed)
        names = names.replace("coverage_min", "coverage").replace(">", "against")
        raise FailedVerdictError(f"{len(missed)} of {len(result['verdicts'])} limits missed: {names}")


def _write_page(result: dict[str, Any], html: Path) -> None:
    from importlib import import_module

    try:
        page = import_module("sfr_loc_map.report.page")
    except ImportError as error:
        raise MissingExtraError(f"the report page is not available ({error}): leave out --html") from error
    page.write_page(result, html)


def score_tables(result: dict[str, Any]) -> list[Any]:
    """Return the score as rich tables: trajectory, map, calls, verdicts, as far as they are there."""
    tables = []
    if "trajectory" in result:
        tables.append(_trajectory_table(result["trajectory"]))
    if "map" in result:
        tables.append(_map_table(result["map"]))
    if result.get("timing") or result.get("memory"):
        tables.append(_calls_table(result.get("timing", {}), result.get("memory", {})))
    if "target" in result:
        tables.append(_calls_table(result["target"]["timing"], result["target"]["memory"]))
    if result.get("verdicts"):
        tables.append(_verdict_table(result["verdicts"]))
    if not tables:
        raise ConfigError("nothing was scored: give an estimate and its truth")
    return tables


def _table(title: str, *columns: str) -> Any:  # noqa: ANN401 - rich is imported late
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for number, column in enumerate(columns):
        table.add_column(column, justify="left" if number == 0 else "right", no_wrap=number == 0)
    return table


def _trajectory_table(trajectory: dict[str, Any]) -> Any:  # noqa: ANN401
    facts = f"{trajectory['matched']} frames of {trajectory['estimate_poses']} estimates, {trajectory['lost']} lost"
    table = _table(
        f"Trajectory: {facts}; re-based by {trajectory['rebase']}; n sub-trajectories",
        *("error", "mean", "sigma", "mean+3sigma", "95 % interval", "n"),
    )
    for part in trajectory.get("conditions", [trajectory]):
        condition = " ".join(f"{value:g} {key.split('_')[-1]}" for key, value in part["condition"].items())
        for name, unit in (("position_m", "m"), ("attitude_deg", "deg"), ("heading_deg", "deg")):
            figure = part[name]
            label = f"{name.split('_')[0]}, {unit}, over {condition}"
            numbers = [_number(figure[key]) for key in ("mean", "sigma", "mean_plus_3sigma")]
            table.add_row(label, *numbers, _interval(figure["mean_plus_3sigma_ci95"]), str(part["count"]))
    return table


def _map_table(part: dict[str, Any]) -> Any:  # noqa: ANN401
    low, high = part["coverage_range_m"]
    name = "distance to the nearest true point" if part["nearest_only"] else "point error"
    title = f"Map: {part['points']} points of {part['pairs']} pairs; coverage {_number(part['coverage'])}"
    title += f" from {low:g} to {high:g} m"
    table = _table(title, f"{name}, m", "mean", "sigma", "mean+3sigma", "p50", "p95", "n", "coverage")
    keys = ("mean", "sigma", "mean_plus_3sigma", "p50", "p95", "count")
    total = part["nearest_distance_m"] if part["nearest_only"] else part["point_error_m"]
    table.add_row("all", *(_number(total[key]) for key in keys), "")
    for item in part.get("by_range", []):
        numbers = [_number(item[key]) for key in (*keys, "coverage")]
        table.add_row(f"{item['from_m']:g} to {item['to_m']:g} m", *numbers)
    return table


def _calls_table(timing: dict[str, Any], memory: dict[str, Any]) -> Any:  # noqa: ANN401
    clocks = {item["clock"] for item in timing.values()}
    title = f"Calls (clock: {', '.join(sorted(clocks)) or 'none'})"
    table = _table(title, "call, s", "n", "p50", "p95", "p99", "max", "mean+3sigma", "peak MiB")
    for name in ("localisation", "mapping", "fusion"):
        figure = timing.get(f"{name}_s")
        peak = memory.get(f"{name}_peak_bytes")
        if figure is not None:
            numbers = [_number(figure[key]) for key in ("count", "p50", "p95", "p99", "max", "mean_plus_3sigma")]
            table.add_row(name, *numbers, _number(None if peak is None else peak / 2**20))
    return table


def _verdict_table(verdicts: list[dict[str, Any]]) -> Any:  # noqa: ANN401
    table = _table("Verdicts", "limit", "bound", "value", "95 % interval", "verdict")
    colours = {"pass": "green", "fail": "bold red"}
    for item in verdicts:
        condition = " ".join(f"{key}={value:g}" for key, value in item.get("condition", {}).items())
        word = item["verdict"]
        colour = colours.get(word, "yellow")
        numbers = (_number(item["limit"]), _number(item["value"]), _interval(item["ci95"]))
        table.add_row(f"{item['metric']} {condition}".strip(), *numbers, f"[{colour}]{word}[/{colour}]")
    return table


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.4g}"


def _interval(bounds: list[float] | None) -> str:
    return "" if bounds is None else f"{bounds[0]:.4g} to {bounds[1]:.4g}"
