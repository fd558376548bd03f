"""Comparison of a stored plan with the files from which the plan was made.

Without this comparison, a suite would pass if a job and its result were deleted from its folder.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

from sfr_loc_map.errors import InputError
from sfr_loc_map.suite.running.digests import code_fingerprint
from sfr_loc_map.suite.running.job import Job, digest
from sfr_loc_map.suite.running.plan import make_plan
from sfr_loc_map.suite.running.source_readers import inspect_file
from sfr_loc_map.suite.running.specification import load_specification
from sfr_loc_map.suite.running.store import Store


def check_plan(store: Store) -> list[str]:
    """Plan the suite again from its file and its sources; return what could not be compared, one sentence each.

    The sources are read again, and the facts in the stored plan are not used. Raise InputError if the suite's file or
    its limits have changed, if the stored plan lacks a job or a source, or if it has a job that the suite does not
    have.
    """
    absent = [f"The plan was not compared with '{path}', because this file is missing." for path in store.check_files()]
    if absent:
        return absent
    if store.suite_file is None:
        raise InputError(f"'{store.plan_file}' does not name the file of its suite: run the suite again")
    try:
        specification = load_specification(store.suite_file)
    except InputError as error:  # no source of the suite can be read
        return [f"The plan was not compared with the sources of the suite, which cannot be read now: {error}."]
    jobs, refusals = make_plan(specification, inspect_file, store.cache)
    _check_jobs(store, jobs)
    planned = {refusal.path for refusal in store.planned_refusals}
    unread = [refusal.path for refusal in refusals if refusal.path not in planned]
    for entry in unread:
        if not _has_job(store, entry):
            raise _differs(store, f"the source '{entry}' is missing in the plan")
    return [f"The plan was not compared with '{entry}', which cannot be read now." for entry in unread]


def _has_job(store: Store, entry: str) -> bool:
    """Return whether the stored plan has a job of an entry of `sources`: the name, path or glob of a source."""
    pattern = str(store.suite_file.parent / entry) if store.suite_file is not None else entry
    return any(
        entry in (job.source.name, *job.source.identical, job.source.path) or fnmatch(job.source.path, pattern)
        for job in store.jobs
    )


def _check_jobs(store: Store, jobs: list[Job]) -> None:
    """Raise InputError if the stored jobs differ from the jobs of the suite's file.

    Stored jobs of a source that does not exist any more are not compared.
    """
    has_same_code = {job.code for job in store.jobs} <= {code_fingerprint()}
    stored = dict(_by_identity(store.jobs, has_same_code=has_same_code))
    made = dict(_by_identity(jobs, has_same_code=has_same_code))
    for identity, job in made.items():
        if identity not in stored:
            raise _differs(store, f"the job '{job.label}' of the suite is missing in the plan, or has other inputs")
    for identity, job in stored.items():
        if identity not in made and Path(job.source.path).exists():
            raise _differs(store, f"the job '{job.label}' is not a job of the suite")


def _by_identity(jobs: tuple[Job, ...] | list[Job], *, has_same_code: bool) -> Iterator[tuple[str, Job]]:
    """Yield each job by the hash of its content without paths and code.

    Another version of the code may detect other copies of drives, so that the drive is only compared for the same code.
    """
    for job in jobs:
        drive = job.source.drive if has_same_code else ""
        source = replace(job.source, path="", truth="", drive=drive)
        yield digest(replace(job, source=source, code="")), job


def _differs(store: Store, difference: str) -> InputError:
    return InputError(f"'{store.plan_file}' differs from '{store.suite_file}': {difference}; run the suite again")
