"""The metrics of the specification: errors, time and memory.

`formulas` has the formulas of the specification in the order of its clauses, `score` the table of figures, and
`judging` the verdicts. The modules that compute scores are `trajectory_score`, `cloud_error` and `calls`. This package
does not import them, so that its import is fast.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
