"""From a score and a limits file to verdicts, in the order in which the modules are used.

`limits` reads the file, with `bound_terms` of tolerance bounds and the table of `shortfall_kinds`. `limit_scope` says
what a limit is about, `limited_figure` finds its number in the score. `proof` proves limits with a share and a
confidence, by `tolerance` bounds or a `sequential` test. `incomplete` finds what was expected and cannot be judged.
`judge` makes the verdicts of one score, `several_scores` the common verdict. `reasons` states why a verdict is open.
`limits_template` writes a limits file to start from.
"""
