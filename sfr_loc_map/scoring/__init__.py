"""Scores with provenance from files, data in memory or topics.

The modules in the order of their use:

- inputs: `inputs` defines the run to be scored (`Run`), and `settings` the settings by name. `load` builds a run from
  files or from data in memory, and uses `bag_estimates` to read the estimates of a bag.
- conventions: `conversion` converts the estimate to poses of RB in DS and diagnoses convention mismatches.
- score: `score_parts` scores the trajectory, the map and the calls of a run. `assembly` combines these parts to a score
  with verdicts and warnings. `provenance` collects the hashes of the files, the settings and facts of the host.
- entry points: `score_run` scores a finished run. `monitor_score` collects the messages of a live run and scores them
  by `live_score`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
