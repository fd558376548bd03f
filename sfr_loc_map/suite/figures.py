"""The figures of a suite's page: errors by runs, faults against error, cost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from sfr_loc_map.report.plots import Plot, axis, error_scale, largest, marks, scaled
from sfr_loc_map.suite.groups import Drive, Group
from sfr_loc_map.suite.summary import Summary

COLORS = ("@one", "@two", "@three", "@four", "@five")


def suite_figures(summary: Summary) -> list[tuple[str, list[Plot]]]:
    """Return the figures by heading; no text of a user is in them, runs stand as their number in the table `runs`."""
    members = [(number, group, _members(summary, group)) for number, group in enumerate(summary.groups, 1)]
    driven = [(number, group, drives) for number, group, drives in members if group.conditions]
    sections = [("Errors", [*_errors(driven), *_faults(driven)]), ("Cost", _cost(summary))]
    return [(title, plots) for title, plots in sections if plots]


def _members(summary: Summary, group: Group) -> list[Drive]:
    named = (group.task, group.configuration, group.faults)
    return [drive for drive in summary.drives if (drive.task, drive.configuration, drive.faults) == named]


def _position(drive: Drive) -> float | None:
    trajectory = drive.score.trajectory
    return None if trajectory is None else trajectory.first.position_m.mean_plus_3sigma


def _errors(driven: Sequence[tuple[int, Group, list[Drive]]]) -> list[Plot]:
    points = [(number, value) for number, _, drives in driven for drive in drives if (value := _position(drive))]
    if not points:
        return []
    pooled = [(number, group.conditions[0].position_m.mean_plus_3sigma) for number, group, _ in driven]
    factor, unit = error_scale(largest([value for _, value in points]))
    traces = [
        marks("one drive", ([n for n, _ in points], scaled([v for _, v in points], factor)), "@one", size=6),
        marks(
            "all drives pooled",
            ([n for n, _ in pooled], scaled([v for _, v in pooled], factor)),
            "@two",
            symbol="line-ew-open",
            size=22,
        ),
    ]
    layout = {
        "xaxis": axis("runs, by their number in the table", dtick=1),
        "yaxis": axis(f"position, mean + 3 sigma, {unit}", type="log"),
    }
    caption = "Each drive, and the sub-trajectories of all drives pooled; first condition."
    return [Plot("suite-errors", "Position error by runs", caption, traces, layout, width="full")]


def _faults(driven: Sequence[tuple[int, Group, list[Drive]]]) -> list[Plot]:
    """Return how each fault changes the error of the same drives, run without faults."""
    points = list(_fault_ratios([(number, drive) for number, _, drives in driven for drive in drives]))
    if not points:
        return []
    trace = marks("one drive", ([n for n, _ in points], [float(f"{v:.6g}") for _, v in points]), "@three", size=6)
    layout = {
        "xaxis": axis("runs, by their number in the table", dtick=1),
        "yaxis": axis("error over that without faults", type="log"),
    }
    caption = "Mean + 3 sigma of the position with the fault, over that of the same drive without it."
    return [Plot("suite-faults", "Faults against error", caption, [trace], layout, width="full")]


def _fault_ratios(drives: Sequence[tuple[int, Drive]]) -> Iterator[tuple[float, float]]:
    """Yield number of the runs and error with the fault over that without, where both are known."""
    clean = {_identity(drive): _position(drive) for _, drive in drives if not drive.faults}
    for number, drive in drives:
        value, reference = _position(drive), clean.get(_identity(drive))
        if drive.faults and value and reference:
            yield float(number), value / reference


def _identity(drive: Drive) -> tuple[str, str, int]:
    return drive.configuration, drive.source, drive.repeat


def _cost(summary: Summary) -> list[Plot]:
    timed = [drive for drive in summary.drives if drive.seconds is not None]
    kinds = list(dict.fromkeys(drive.task for drive in timed))
    traces = []
    for kind, color in zip(kinds, COLORS, strict=False):
        chosen = [drive for drive in timed if drive.task == kind]
        pairs = [_pairs(drive) for drive in chosen]
        seconds = [float(f"{drive.seconds:.4g}") for drive in chosen]
        traces.append(marks(kind, (pairs, seconds), color, size=6))
    layout = {"xaxis": axis("pairs"), "yaxis": axis("seconds", rangemode="tozero")}
    caption = "Time of a whole task: start of the process, reading, work, score."
    return [Plot("suite-cost", "Time of tasks", caption, traces, layout, width="full")] if traces else []


def _pairs(drive: Drive) -> float:
    score = drive.score
    return float(score.trajectory.estimate_poses if score.trajectory else score.map.pairs if score.map else 0)
