"""Scores with provenance from files, data in memory or topics.

The steps from an estimate and a ground truth to a verdict:

    ScoreInputs, InMemory ── load.load_run ──► Run ── conversion.converted_run ──► Run (poses of RB in DS)
    Run ── score_run: one function of results for trajectory, map and calls ──► TrajectoryResult, MapResult, CallsResult
    results ── assembly.score_of_results: figures, then verdicts by metrics.judging ──► Score

`load` reads the files, and `provenance` hashes them. All other steps take values and return values. The modules in the
order of their use:

- inputs: `inputs` defines what the user gives (`ScoreInputs`, `InMemory`) and the run to be scored (`Run`).
  `judgement` finds the limits and conditions. `load` builds a run from files or from data in memory: `load_calls`
  reads the calls, `load_drive` the poses (from a bag with `bag_estimates`), and `load_map` the cloud. `call_checks`
  refuses calls of another run. `input_files` notes the state of each file before reading, so that a changed file is
  refused when the files are hashed. `load_trajectories` reads poses for pages without a score.
- conventions: `conversion` converts the estimate to poses of RB in DS and diagnoses convention mismatches.
- score: `results` scores the trajectory, the map and the calls of a run. `assembly` makes a score of these results,
  with verdicts and warnings. `provenance` collects the hashes of the files, the settings and facts of the host.
- entry points: `score_run` scores a finished run, and `live` a run in progress from its messages. `request` takes the
  options of a user by name, and converts and scores a run with these options (`ScoreRequest.scored`).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
