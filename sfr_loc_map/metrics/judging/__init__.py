"""From a score and a limits file to verdicts, in the order in which the modules are used.

`limits_file` reads the limits (`metrics.limits`). `limited_figure` finds the number of a limit in the score, and
`limit_scope` states which part of the run the limit needs. `proof` proves limits with a share and a confidence, by
tolerance bounds (`metrics.tolerance`) or a `sequential` test. `incomplete` finds what was expected and cannot be
judged. `judge` makes the verdicts of one score, and `several_scores` the common verdict. `reasons` states why a verdict
is open. `limits_template` writes a limits file to start from.

The modules here import `metrics`. Of `metrics`, only `stored` imports modules from here: the check of a score that was
read derives the verdicts again.
"""
