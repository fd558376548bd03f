"""The metrics of the specification: errors, time and memory, and the verdicts on them.

    poses, truth ─► conventions ─► frames ─► errors (trajectory_score) ─┐
    cloud, truth of pairs ─────────────────► errors (map_score) ────────┼─► score ─► judging ─► stored
    times, memory ─────────────────────────► calls (call_score) ────────┘              ▲
    statistics, completeness ──────────────► rows of errors and calls                  │
    poses, truth ─► diagnosis ─► finding ──────────────────────────────────────────────┤
    limits file ───────────────────────────────────────────────────────────────────────┘

`conventions` and `frames` return poses and values, `errors` and `calls` return results with rows (`figures.results`),
and `diagnosis` returns a finding. `errors` and `calls` take the statistics of their rows from `formulas` and
`statistics`, and the rows of completeness from `completeness`, because these rows depend on what was expected and
judged.
`score.joined_parts.score_of_results` joins the results to a `Score`, and `judging.judge.judged_by` adds the verdicts.
The package `scoring` reads the inputs, calls these functions, and adds the provenance and the warnings.

Everything that can be missing or wrong is a line of `completeness.shortfall_kinds`, which `judging.incomplete`
evaluates; `completeness` has the drawing. `figures.subjects` states which figures, expected items and task
belong together.

`statistics` are also used by `judging` and `stored`.

The modules outside of the folders: `formulas` contains the formulas of the specification in the order of its
clauses. `other_formulas` has the formulas of figures that the specification does not define. `conditions` defines
where a sub-trajectory ends, `sub_trajectories` its errors, and `config` the settings and the enumerations of all
folders.

The folders, from the bottom (`METRICS_FLOORS` in `test/test_layers.py`). A folder imports only lower folders:

- `statistics`: statements about all errors from a sample of them.
- `figures`: the catalogue of all figures, the rows of a score and their parts, and the other records.
- `frames`: pairs of an estimated and a true pose in common axes, and the error of the true pose.
- `completeness`: what is expected of each subject, and how much of it is judged, missing or wrong.
- `conventions`: the conversion of estimates from the convention in which they were written.
- `errors`: the errors of the trajectory and of the cloud as rows.
- `calls`: time and memory of calls, and their rows.
- `diagnosis`: the search for a convention of poses that is not declared.
- `score`: the table with its limits, verdicts and caveats.
- `judging`: the verdicts, as a function of a score and its limits.
- `stored`: scores as files, the check of a file, and the comparison of scores.

This package imports none of its modules, so that its import is fast.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
