"""Suites: many jobs on Dask, the statistics of their results, and the search for the worst case.

    SUITE.yaml ──> plan ──> jobs ──> workers ──> store ──> summary ──> pages

    planning/     reads SUITE.yaml, finds and hashes the sources, and lists all jobs: Plan
    jobs/         one Job: its source, its configuration, its identities, and its work, which returns a Score
    workers/      gives jobs to Dask workers, with limits of time and memory: JobOutcome
    store.py      the folder of the suite: plan, results, failures. A job without result and failure is waiting
    statistics/   reads the results and judges them, alone and over all drives: Summary
    pages/        suite.json, report.html and other files, from the Summary

`run.py` calls these parts in this order. The docstring of each folder lists its modules.

`search/` chooses points of a scenario, runs their jobs in the same way, and reads their results from the folder.
`history/` compares the `suite.json` of many nights.

Terms, each with one meaning in this package:

    source      the data that a job reads: a recording, a simulation, or an estimate with its truth. An entry of the
                suite's file states one or more sources (jobs/sources.py). A source of error is another term
    drive       the path that a source shows. Sources that are copies, and the repeats of a job, have one drive, which
                counts once in statistics
    task        what a job does with its source, an entry of `tasks`: localise, map, replay or score (`JobTask`).
                `Task` of the other packages is localisation or mapping
    job         one source with one fault, one configuration and one repeat, for one task; jobs/job.py lists its
                identities
    result      the score of a job, in one file
    group       the results with the same task, configuration and faults or variant; their errors are pooled
    plan        the list of jobs. (The command `sfr suite plan` computes a number of drives.)
    night       one run of the suite in a history, in a folder of its own
    run         one execution of `sfr suite run` or `sfr suite search`, which may continue an earlier one
    point       one choice of the parameters of a search, with a job for each seed

The files of a job determine its state (`Store.state`). `Store.left_over` finds results and failures of work that the
plan does not contain. `Summary.counts` and `Summary.completeness` count the jobs. `SuiteWorkers` counts the finished
jobs of each worker.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
