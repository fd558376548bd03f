"""Comparison of a stored plan with the files from which the plan was made.

Without this comparison, a suite would pass if a job and its result were deleted from its folder.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from msgspec.structs import replace as struct_replace

from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.suite.running.configurations import METHOD_FILES
from sfr_loc_map.suite.running.digests import code_fingerprint
from sfr_loc_map.suite.running.facts_cache import FactsCache
from sfr_loc_map.suite.running.job import Job, digest
from sfr_loc_map.suite.running.plan import make_plan
from sfr_loc_map.suite.running.sources import Estimate, PlannedSource, Simulation
from sfr_loc_map.suite.running.specification import Refusal, load_specification
from sfr_loc_map.suite.running.store import Store


def check_plan(store: Store) -> list[str]:
    """Plan the suite again from its file and its sources; return what could not be compared, one sentence each.

    Raise InputError if the suite's file or its limits have changed, if the stored plan lacks a job or a source, or if
    it has a job that the suite does not have.
    """
    absent = [f"The plan was not compared with '{path}', because this file is missing." for path in store.check_files()]
    if absent:
        return absent
    if store.suite_file is None:
        raise InputError(
            f"'{store.plan_file}' does not name the file of its suite: run the suite again (a search has its results "
            "in search.html)"
        )
    try:
        specification = load_specification(store.suite_file)
    except SfrError as error:  # the sources, or the files of a method, are missing; the suite's file is unchanged
        return [f"The plan was not compared with the sources of the suite, which cannot be read now: {error}."]
    jobs, refusals = make_plan(specification, FactsCache(store.cache).facts_of, store.cache)
    planned = {refusal.subject for refusal in store.planned_refusals}
    unreadable_now = [refusal for refusal in refusals if refusal.subject not in planned]
    for refusal in unreadable_now:
        if refusal.task or not any(_is_refused(job.source, refusal) for job in store.jobs):
            raise _differs(store, f"the source '{refusal.name}' is missing in the plan")
    gone = _check_jobs(store, jobs, unreadable_now)
    return [f"The plan was not compared with '{path}', which cannot be read now." for path in gone]


def _is_refused(source: PlannedSource, refusal: Refusal) -> bool:
    """Return whether a refusal is about a source, or about the complete entry of the source."""
    return source.entry == refusal.entry and refusal.source in ("", source.location)


def _check_jobs(store: Store, jobs: Sequence[Job], unreadable_now: Collection[Refusal]) -> list[str]:
    """Return the paths of the sources of stored jobs that cannot be read now; their jobs are not compared.

    Raise InputError if the other stored jobs differ from the jobs of the suite's file.
    """
    has_same_code = {job.code for job in store.jobs} <= {code_fingerprint()}
    stored = _by_content(store.jobs, has_same_code=has_same_code)
    planned_now = _by_content(jobs, has_same_code=has_same_code)
    for content, job in planned_now.items():
        if content not in stored:
            raise _differs(store, f"the job '{job.label}' of the suite is missing in the plan, or has other inputs")
    gone: dict[str, None] = {}
    for content, job in stored.items():
        if content in planned_now:
            continue
        is_refused = any(_is_refused(job.source, refusal) for refusal in unreadable_now)
        if Path(job.source.path).exists() and not is_refused:
            raise _differs(store, f"the job '{job.label}' is not a job of the suite")
        gone[job.source.path] = None
    return list(gone)


def _by_content(jobs: Sequence[Job], *, has_same_code: bool) -> Mapping[str, Job]:
    """Return each job by the hash of what two plans of one suite have in common.

    This is the content of the job except the code, paths, the states of files, and the hash of the files in
    SFR_METHOD_FILES. This variable may be unset, because a report runs no method. Another version of the code may
    detect other copies of drives, so that the drive is only compared for the same code.
    """
    found: dict[str, Job] = {}
    for job in jobs:
        drive = job.source.drive if has_same_code else ""
        input_files = {name: sha256 for name, sha256 in job.input_files.items() if not name.endswith(METHOD_FILES)}
        compared = replace(job, source=_without_paths(job.source, drive), input_files=input_files, code="")
        found[digest(compared)] = job
    return found


def _without_paths(source: PlannedSource, drive: str) -> PlannedSource:
    """Return a source without paths and states of files, and with the given drive."""
    known = struct_replace(source, path="", entry=0, drive=drive)
    if isinstance(known, Simulation):
        return known
    if isinstance(known, Estimate):
        return struct_replace(known, truth="", state="")
    return struct_replace(known, url="", state="")


def _differs(store: Store, difference: str) -> InputError:
    return InputError(f"'{store.plan_file}' differs from '{store.suite_file}': {difference}; run the suite again")
