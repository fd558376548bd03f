"""Diagnosis of a recording or a running graph: the issues and their fixes.

    sfr info SRC    observation.observe (a bag, or the messages of files)  ──┐
    sfr doctor      graph/observer.py (a graph, over some time)            ──┴─► Observation
                                                                                    │ examination.examine
                                                                                    ▼
                    fixes.with_fix (sfr info: the command that removes the cause) ◄─ list of issues

An `Observation` has only values, and the checks of `examination` are functions of an observation. `issues.Issue` and
`transport_issues.silence_of` are outside of this folder, because nodes and `sfr record` report the same issues.
"""
