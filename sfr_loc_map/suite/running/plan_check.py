"""Comparison of a stored plan with the files from which the plan was made.

Without this comparison, a suite would pass if a job and its result were deleted from its folder.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

from sfr_loc_map.errors import InputError, SfrError
from sfr_loc_map.suite.running.configurations import METHOD_FILES_SHA256
from sfr_loc_map.suite.running.digests import code_fingerprint
from sfr_loc_map.suite.running.facts_cache import FactsCache
from sfr_loc_map.suite.running.job import Job, digest
from sfr_loc_map.suite.running.plan import make_plan
from sfr_loc_map.suite.running.source_names import last_part, pattern_in
from sfr_loc_map.suite.running.specification import load_specification
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
    planned = {refusal.path for refusal in store.planned_refusals}
    unread = [refusal.path for refusal in refusals if refusal.path not in planned]
    folder = store.suite_file.parent
    for entry in unread:
        if not any(_is_of_entry(job, entry, store.cache, folder) for job in store.jobs):
            raise _differs(store, f"the source '{entry}' is missing in the plan")
    gone = _check_jobs(store, jobs, unread, folder)
    return [f"The plan was not compared with '{entry}', which cannot be read now." for entry in gone]


def _is_of_entry(job: Job, entry: str, cache: Path, folder: Path) -> bool:
    """Return whether a job is of an entry of `sources`: the name, path in the folder, glob or URL of a source."""
    path = Path(job.source.path)
    if "://" in entry:  # a remote source was copied to the cache, with the name of its file
        return cache.absolute() in path.parents and fnmatch(path.name, last_part(entry))
    names = (job.source.name, *job.source.identical, job.source.path)
    return entry in names or fnmatch(job.source.path, pattern_in(folder, entry))


def _check_jobs(store: Store, jobs: Collection[Job], unread: Collection[str], folder: Path) -> list[str]:
    """Return the sources of stored jobs that cannot be read now; their jobs are not compared.

    Raise InputError if the other stored jobs differ from the jobs of the suite's file.
    """
    has_same_code = {job.code for job in store.jobs} <= {code_fingerprint()}
    stored = dict(_by_identity(store.jobs, has_same_code=has_same_code))
    made = dict(_by_identity(jobs, has_same_code=has_same_code))
    for identity, job in made.items():
        if identity not in stored:
            raise _differs(store, f"the job '{job.label}' of the suite is missing in the plan, or has other inputs")
    gone: dict[str, None] = {}
    for identity, job in stored.items():
        if identity in made:
            continue
        is_unread = any(_is_of_entry(job, entry, store.cache, folder) for entry in unread)
        if Path(job.source.path).exists() and not is_unread:
            raise _differs(store, f"the job '{job.label}' is not a job of the suite")
        gone[job.source.path] = None
    return list(gone)


def _by_identity(jobs: Collection[Job], *, has_same_code: bool) -> Iterator[tuple[str, Job]]:
    """Yield each job by the hash of its content.

    The hash excludes paths, states of files, the code, and the files in SFR_METHOD_FILES.

    Another version of the code may detect other copies of drives, so that the drive is only compared for the same code.
    The variable SFR_METHOD_FILES may be unset, because a report runs no method.
    """
    for job in jobs:
        drive = job.source.drive if has_same_code else ""
        source = replace(job.source, path="", truth="", state="", drive=drive)
        parameters = {name: value for name, value in job.parameters.items() if not name.endswith(METHOD_FILES_SHA256)}
        yield digest(replace(job, source=source, parameters=parameters, code="")), job


def _differs(store: Store, difference: str) -> InputError:
    return InputError(f"'{store.plan_file}' differs from '{store.suite_file}': {difference}; run the suite again")
