"""`sfr simulate`: a rendered data set with exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from sfr_loc_map.bounded_input import parse_yaml
from sfr_loc_map.cli.app import app
from sfr_loc_map.cli.common import progress_bar
from sfr_loc_map.errors import ConfigError


@app.command()
def simulate(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="[CONFIG] OUT", help="YAML file of a scenario (optional), then the folder or bag to make."
        ),
    ],
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of everything random.")] = None,
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One setting, as terrain.relief_m=0.2.")
    ] = None,
) -> None:
    """Render a drive or a panorama with exact truth; a stopped run continues when called again."""
    from sfr_loc_map.config import build, load_yaml
    from sfr_loc_map.pipeline.simulate import simulate as run
    from sfr_loc_map.simulation.config import SimulationConfig

    if len(paths) > 2:
        raise ConfigError(f"{len(paths)} paths given: a configuration (optional) and an output are needed")
    values = _flat(load_yaml(paths[0])) if len(paths) == 2 else {}
    values.update(parse_settings(settings))
    if seed is not None:
        values["seed"] = seed
    config = build(SimulationConfig, values, origin=str(paths[0]) if len(paths) == 2 else "settings")
    with progress_bar("images") as bar:
        task = bar.add_task("rendering", total=None)
        count = run(config, paths[-1], workers, lambda done, total: bar.update(task, completed=done, total=total))
    typer.echo(f"{count} pairs: {paths[-1]}", err=True)


def parse_settings(settings: list[str] | None) -> dict[str, Any]:
    """Return settings `KEY=VALUE`, the values read as YAML.

    Raises:
        ConfigError: If one has another form.
    """
    values: dict[str, Any] = {}
    for item in settings or []:
        key, separator, text = item.partition("=")
        try:
            value = parse_yaml(text)
        except (yaml.YAMLError, ValueError) as error:
            raise ConfigError(f"'--set {item}': the value is not valid YAML") from error
        if not separator or not key:
            raise ConfigError(f"'--set {item}': must have the form KEY=VALUE, as terrain.relief_m=0.2")
        values[key] = value
    return values


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested names with dots, so that single settings replace those of the file."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        flat.update(_flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value})
    return flat
