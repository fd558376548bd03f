"""Statistics over the results of one suite, and the comparison of two suites.

summary.py              reads the results of a suite, and calls the other modules: Summary
  scored_job.py         a job with its score, judged by the limits: ScoredJob
  groups.py             the results with the same task, configuration and faults: Group
    pooling.py          errors over the sub-trajectories of all drives
    group_verdicts.py   verdicts over all drives
  budget.py             error budgets
  common_deviations.py  deviations of the results from the specification
verdict_texts.py        what prevents a pass, as texts of the command
comparison.py           compares two summaries
drive_count.py          number of drives that a proof requires
figures.py              the figures of a result that comparisons, histories and tables use
resampling.py           intervals by resampling drives
"""
