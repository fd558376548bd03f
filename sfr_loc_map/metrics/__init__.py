"""The metrics of the specification: errors, time and memory, and the verdicts on them.

    estimate, truth ─► conventions ─► frames ─► trajectory ─┐
                       associated by stamps     selected,   │
                                                compared,   │
                                                summarised  │
    cloud, truth of pairs ────────────────────► map ────────┼─► score ─► judging ─► stored
    times, memory ────────────────────────────► calls ──────┘              ▲
    limits file ───────────────────────────────────────────────────────────┘

The rows of each subject are those of `trajectory.trajectory_score.score_trajectory`, of `map.map_score.score_map` (of
`score_nearest` if the pixels of the points are unknown), and of `calls.call_score.score_calls`. These functions take
the statistics of their rows from `formulas` and `statistics`, and the rows of completeness from `completeness`. The
package `scoring` reads the inputs, calls these functions and makes a `Score` of their results.
`judging.judge.judged_by` adds the verdicts. The score of a suite is judged by the same functions
(`suite.statistics`), from the rows of its drives.

Everything that can be missing or wrong in a score is a line of `completeness.shortfall_kinds`, which
`judging.incomplete` evaluates; `completeness` has the drawing. Missing drives of a suite are found by
`suite.statistics`. `figures.subjects` states which figures, expected items and task
belong together.

The modules outside of the folders: `formulas` contains the formulas of the specification in the order of its
clauses. `other_formulas` has the formulas of figures that the specification does not define. `conditions` parses
the conditions that end a sub-trajectory, and `sub_trajectories` has the class of selected sub-trajectories with their
errors. `config` has the settings and the enumerations of all folders. `comparison` compares scores of the same data.

The folders, from the bottom (`METRICS_FLOORS` in `test/test_layers.py`). A folder imports only lower folders:

- `statistics`: statements about all errors from a sample of them.
- `figures`: the catalogue of all figures, the rows of a score and their parts, and the other records.
- `frames`: pairs of an estimated and a true pose in common axes.
- `completeness`: what is expected of each subject, and how much of it is judged, missing or wrong.
- `conventions`: the conversion of estimates from another convention of poses, and the search for an undeclared one.
- `trajectory`, `map`, `calls`: the score of each subject as rows.
- `score`: the table with its limits, verdicts and caveats.
- `judging`: the verdicts, as a function of a score and its limits.
- `stored`: scores as files, and the check of a file. `comparison` is above this folder.

This package imports none of its modules, so that its import is fast.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
