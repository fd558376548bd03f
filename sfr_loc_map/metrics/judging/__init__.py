"""Verdicts: a pure function of a score's table of figures and of its limits.

    limits file ─► limits_file ─► Limits
                                    │
    table of figures, Limits ─┬─► limited      the number of each limit, and its scope that must be complete
                              ├─► proof        tolerance bounds and sequential tests of limits with a fraction
                              ├─► incomplete   shortfalls: what is missing or wrong in each scope (SHORTFALLS)
                              │
                              └─► judge        numbers, proofs and shortfalls ─► verdict on each limit ─► verdict

`judge.with_verdicts` calls the three modules above it and is the complete derivation. `completeness.shortfall_kinds`
is the table of everything that can be missing or wrong.

`several_scores` combines the verdicts of several scores. `reasons` states why a verdict is undecided.
`limits_template` writes a template of a limits file. In `metrics` only `stored` and `comparison` import this
package: the check of a stored score derives its verdicts again, and a comparison states what each score cannot judge.
"""
