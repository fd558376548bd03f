"""Many runs on Dask: suites of sources, configurations and faults, their statistics, and searches.

`run.py` calls these steps in their order:

    SUITE.yaml
      running/specification.py    reads the file: SuiteSpecification (configurations.py, variants.py for budgets)
      running/plan.py             hashes each source (digests.py), finds copies of drives (drive_copies.py) and combines
                                  sources, faults and configurations to jobs (job.py)
      running/store.py            DIR/plan.json has the jobs; a job without a file of its key is waiting
      running/cluster.py          gives the waiting jobs to Dask workers, with limits of time and memory
        running/job_run.py        on a worker: renders or opens the source (sources.py), runs and scores it: Score
      running/store.py            DIR/results/KEY.json or DIR/failures/KEY.json
      statistics/summary.py       groups, pooled errors (pooling.py), verdicts (group_verdicts.py), error budgets
                                  (budget.py): Summary
      pages/page.py               suite.json, report.html, pages/, results.parquet (tables.py, export.py)

`search/` chooses points of a scenario, runs their jobs in the same way and reads their results from the folder.
`statistics/comparison.py` compares two summaries, and `statistics/history.py` the `suite.json` of many nights.

Terms:

    source      the data of a job: a recording, a remote recording, a simulation, or an estimate with its truth
    drive       the path that sources show; copies of a source, and repeats, are one drive and count once in statistics
    job         one source with one fault, one configuration and one repeat, for one task (`JobKind`); its key is a hash
                of all inputs of its result
    group       the results with the same task, configuration and faults; their errors are pooled. Tables call it "runs"
    plan        the list of jobs. The command `sfr suite plan` is about the number of drives (statistics/drive_count.py)

The files of a job determine its state (`Store.state`): done, failed or waiting. `Store.left_over` finds results and
failures of work that the plan does not contain. `Summary.counts` and `Summary.completeness` count the jobs, and
`SuiteWorkers` counts the finished jobs of each worker.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
