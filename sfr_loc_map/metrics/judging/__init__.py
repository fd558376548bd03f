"""Verdicts from a score and a limits file. This text names the modules in the order of their use.

`limits_file` reads the limits (`metrics.score.limits`), and `data_set` checks that the score was made with the data
that they name. `limited_value` finds the number of a limit in the score, and `limit_scope` states which part of the run
the limit requires. `proof` proves limits with a fraction and a confidence, by tolerance bounds (`metrics.statistics`)
or a `sequential` test. `incomplete` finds expected data that cannot be judged. `judge` makes the verdicts of one score,
and `several_scores` the common verdict. `reasons` states why a verdict is undecided. `limits_template` writes a
template of a limits file.

In `metrics` only `stored` imports this package, because the check of a stored score derives the verdicts again.
"""
