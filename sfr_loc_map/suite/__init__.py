"""Jobs on Dask: suites of sources, configurations and faults, their statistics, and searches for the worst case.

`run.py` calls these steps in their order:

    SUITE.yaml
      running/specification.py    parse, check and discover: SuiteSpecification (configurations.py, variants.py)
        running/source_entries.py finds the sources of each entry of `sources`, with unique names
      running/plan.py             combines sources, faults and configurations: Plan, a list of Job
        running/source_inspection.py  reads and hashes the data of a source (digests.py, source_cache.py)
        running/drive_copies.py   finds the sources that are copies or parts of one drive
      running/data_set.py         compares the sources with the hashes in the limits
      running/store.py            DIR/plan.json; a job with neither result nor failure in DIR is waiting
      running/cluster.py          gives the waiting jobs to Dask workers, with limits of time and memory
        running/job_run.py        on a worker: opens or renders the source, executes and scores the job: Score
      running/store.py            DIR/results/KEY.json or DIR/failures/KEY.json (job_outcome.py)
      statistics/summary.py       makes the Summary of the results, read and judged by scored_job.py, with
        statistics/groups.py      pooled errors (pooling.py) and verdicts (group_verdicts.py) of each group
        statistics/budget.py      error budgets
        statistics/common_deviations.py  deviations of the results
      statistics/verdict_texts.py what prevents a pass, as texts of the command
      pages/page.py               suite.json, report.html, pages/, results.parquet (tables.py, export.py)

`search/` chooses points of a scenario, runs their jobs in the same way and reads their results from the folder. The
page of a search, `search.json` and the evidence of a test report are made from one record (`search/record.py`).
`statistics/comparison.py` compares two summaries, and `history/` compares the `suite.json` of many nights. Both pair
the jobs by `PairKey` (job.py). `store.py` states which process writes which file.

Terms, each with one meaning in this package:

    source      the data that a job reads: a recording, a simulation, or an estimate with its truth. An entry of the
                suite's file states one or more sources (running/sources.py). A source of error is another term
    drive       the path that a source shows. Sources that are copies, and the repeats of a job, have one drive, which
                counts once in statistics
    task        what a job does with its source, an entry of `tasks`: localise, map, replay or score (`JobTask`).
                `Task` of the other packages is localisation or mapping
    job         one source with one fault, one configuration and one repeat, for one task; running/job.py lists its
                identities
    result      the score of a job, in one file
    group       the results with the same task, configuration and faults; their errors are pooled
    plan        the list of jobs. (The command `sfr suite plan` computes a number of drives.)
    night       one run in a history
    run         one execution of `sfr suite run` or `sfr suite search`, which may continue an earlier one
    point       one choice of the parameters of a search, with a job for each seed

The files of a job determine its state (`Store.state`). `Store.left_over` finds results and failures of work that the
plan does not contain. `Summary.counts` and `Summary.completeness` count the jobs. `SuiteWorkers` counts the finished
jobs of each worker.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
