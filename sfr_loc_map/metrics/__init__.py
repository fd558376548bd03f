"""The metrics of the specification: errors, time and memory.

`formulas` has the specification's formulas in the order of its clauses, `score` the table of figures, `judging` the
verdicts. What is imported here is light; the functions that compute scores are in `trajectory_score`, `cloud_error` and
`calls`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
