"""The metrics of the specification: errors, time and memory, and the verdicts on them.

The modules by subject, each subject in the order of its use:

- formulas: `formulas` implements the formulas of the specification in the order of its clauses, and the statistics of
  errors.
- table of figures: `catalogue` lists every figure. `row_part` defines the parts of rows, `table` the rows, `config` the
  settings, and `score` the score: the table, the verdicts (`verdict`), `records` and the data of the plots (`details`).
- trajectory: `association` pairs estimates with true poses, `placement` makes the frames, `trajectory_errors` selects
  the `sub_trajectories` and makes their rows, and `trajectory_score` makes the score. It also calls `other_frames` and
  `standing` (errors that the figures do not contain), `copies`, `truth_error`, `consistency` (NEES), `three_sigma` and
  `plot_columns`.
- map and calls: `cloud_error` scores clouds. `call_meter` measures a call, and `calls` scores the calls of a run.
- results: `results` defines the result of each part (trajectory, map, calls), from which `scoring` makes a score.
- completeness: `shortfall_kinds` is the table of what is expected and when a result is incomplete.
  `drive_completeness` and `completeness` (map, calls, live run) count the expected and the judged items.
- statistics: `intervals` computes the 95 % interval of mean + 3 sigma, `tolerance` the tolerance bounds.
- verdicts: `limits` defines the limits, and the package `judging` makes the verdicts.
- stored scores: `score_json` reads and writes scores. `stored` and `raw_values` check a score that is read.
- conventions: `pose_convention` converts estimates of another convention, `convention_diagnosis` finds the convention.
- beside the specification: `aligned_error` (APE and RPE), `comparison` of several scores, `caveats`.

This package imports none of its modules, so that its import is fast.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
