"""Export of a suite: JUnit XML, a run of MLflow, and the results as Parquet."""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path

from sfr_loc_map import __version__
from sfr_loc_map.atomic import atomic_path
from sfr_loc_map.errors import MissingExtraError, OutputError
from sfr_loc_map.message_text import counted, one_line
from sfr_loc_map.metrics.conditions import label_of
from sfr_loc_map.metrics.figures.rows import COLUMNS
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.report.junit import junit
from sfr_loc_map.suite.statistics.figures import figures_of
from sfr_loc_map.suite.statistics.summary import Summary

EXPERIMENT = "sfr suite"  #: Name of the MLflow experiment.


def suite_junit(summary: Summary) -> str:
    """Return JUnit XML: test cases for the limits over all drives, for those of each drive, and for missing results."""
    jobs = [result.job for result in summary.results]
    labels = Counter(job.label for job in jobs)
    labels.update(failure.label for failure in summary.failures)
    labels.update(refusal.name for refusal in summary.refusals)

    def unique_name(label: str, key: str) -> str:
        return label if labels[label] == 1 else f"{label}, {key}"

    failed = {unique_name(item.label, item.key): f"{item.cause}: {item.message}" for item in summary.failures}
    refused = {
        unique_name(refusal.name, f"refusal {number}"): refusal.reason
        for number, refusal in enumerate(summary.refusals, 1)
    }
    judged = {f"all drives, {group.key.text}": summary.score_of(group) for group in summary.groups}
    counts = summary.counts
    waiting = {"jobs": f"{counts.waiting} of {counts.jobs} have no result yet"} if counts.waiting else {}
    scores = {unique_name(result.job.label, result.job.key): result.score for result in summary.results}
    of_all = [f"{item.text} ({counted(item.results, 'result')})" for item in summary.deviations]
    return junit(judged | scores, failed | refused | waiting, dict.fromkeys(judged, of_all))


def write_parquet(summary: Summary, path: Path) -> None:
    """Write the figures of all results as one table, each row with its job; without pyarrow, do nothing."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return

    names = dict.fromkeys(("key", "label", "task", "source", "configuration", "faults", "variant"), "string")
    names |= dict.fromkeys(("seed", "repeat"), "int64")
    words = dict.fromkeys(("clause", "subject", "condition", "part", "figure", "unit"), "string")
    numbers = {name: "int64" if name == "n" else "float64" for name in COLUMNS if name not in words}
    rows = [result.names() | row.as_dict() for result in summary.results for row in result.score.figures]
    schema = pyarrow.schema(list((names | words | numbers).items()))
    with atomic_path(path) as temporary:
        pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows, schema=schema), temporary)


def log_to_mlflow(summary: Summary, folder: Path, uri: str) -> str:
    """Log pooled errors, counts, tags and files of a suite as an MLflow run; return the ID of the run."""
    try:
        import mlflow
    except ImportError as absent:
        raise MissingExtraError(f"'--mlflow' requires MLflow ({absent}): pip install 'sfr_loc_map[mlflow]'") from absent
    values = {name: float(value) for name, value in to_plain(summary.counts).items()}
    means: dict[str, list[float]] = {}
    for result in summary.results:
        for figure, value in figures_of(result.score).items():
            name = "/".join((*result.job.group.parts, f"drive mean of {figure.name}"))
            means.setdefault(name, []).append(value)
    values |= {name: sum(of_drives) / len(of_drives) for name, of_drives in means.items()}
    for group in summary.groups:
        for row in group.figures:
            name = "/".join((*group.key.parts, label_of(row.condition), row.figure))
            values |= {f"{name}/{key}": value for key, value in row.as_dict().items() if isinstance(value, float)}
    metrics = [(re.sub(r"[^\w\-. :/]", "_", name), value) for name, value in values.items() if isinstance(value, float)]
    about = {"verdict": summary.verdict, "code": summary.code, "version": __version__, **summary.run}
    tags = {f"sfr.{name}": value for name, value in about.items() if value is not None}
    try:
        mlflow.set_tracking_uri(uri)
        mlflow.set_experiment(EXPERIMENT)
        with mlflow.start_run(run_name=folder.name) as run:
            mlflow.set_tags(
                {name: value if isinstance(value, str) else json.dumps(value) for name, value in tags.items()}
            )
            for first in range(0, len(metrics), 500):
                mlflow.log_metrics(dict(metrics[first : first + 500]))
            for name in ("suite.json", "report.html", "results.parquet"):
                if (folder / name).exists():
                    mlflow.log_artifact(str(folder / name))
            mlflow.end_run("FAILED" if summary.failures or summary.refusals else "FINISHED")
    except (mlflow.MlflowException, OSError) as reason:
        raise OutputError(f"MLflow at '{uri}' rejected the run: {one_line(str(reason))}; check the address") from reason
    return str(run.info.run_id)
