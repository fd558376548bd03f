"""The check, before a suite runs, that its sources are the data that its limits name (`data_set_sha256`)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from sfr_loc_map.errors import ConfigError, InputError
from sfr_loc_map.metrics.figures.records import InputFile
from sfr_loc_map.metrics.judging.limited import fault_of_inputs
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.scoring.inputs import ScoreInputs
from sfr_loc_map.scoring.load import load_run
from sfr_loc_map.scoring.provenance import data_set_of, provenance_of
from sfr_loc_map.suite.jobs.job import Job, JobTask
from sfr_loc_map.suite.jobs.sources import Estimate, Recording, Simulation
from sfr_loc_map.suite.planning.specification import Refusal

ROLES_OF_TASK = {JobTask.LOCALISE: ("truth", "truth_file", "images"), JobTask.MAP: ("map_truth",)}
"""Inputs of a data set that the score of a task states, if the source has them. Other tasks state all inputs."""


def check_data_sets(planned: Iterable[Job], jobs: Collection[Job], limits: Limits | None) -> tuple[Refusal, ...]:
    """Return a refusal for each hash of data that the limits name and that no source of a planned job has.

    InputError if the data of one of the `jobs`, which are to be executed, have a hash that the limits do not name.
    ConfigError if such a source is simulated, because its data do not exist before its jobs run.
    """
    if limits is None or not limits.data_set_sha256:
        return ()
    inputs_of_data: dict[str, Mapping[str, InputFile]] = {}  # by hash of the data
    for job in planned:
        source = job.source
        if source.sha256 not in inputs_of_data and not isinstance(source, Simulation):
            inputs_of_data[source.sha256] = _inputs_of(source)
    for job in {(job.source.sha256, job.task): job for job in jobs}.values():
        source = job.source
        if isinstance(source, Simulation):
            raise ConfigError(
                f"'{source.name}' is simulated, so its data have no hash that the limits could name: omit "
                "data_set_sha256, or give the output of sfr simulate as the source"
            )
        inputs = inputs_of_data[source.sha256]
        roles = ROLES_OF_TASK.get(job.task, tuple(inputs))
        fault = fault_of_inputs(limits.data_set_sha256, {role: inputs[role] for role in roles if role in inputs})
        if fault is not None:
            raise InputError(f"'{source.name}': {fault}")
    present = {file.data_set_sha256 for inputs in inputs_of_data.values() for file in inputs.values()}
    return tuple(
        Refusal(f"data {sha256}", f"no source has the data {sha256} that the limits name (data_set_sha256)")
        for sha256 in limits.data_set_sha256
        if sha256 not in present
    )


def _inputs_of(source: Recording | Estimate) -> Mapping[str, InputFile]:
    """Return the inputs that the scores of a source state, by role."""
    path = Path(source.path)
    if isinstance(source, Estimate):
        return provenance_of(load_run(ScoreInputs.of(path, Path(source.truth)))).inputs
    from sfr_loc_map.io.registry import open_source  # slow import

    opened = open_source(path)
    return data_set_of(opened)
