"""The metrics of the specification: errors, time and memory.

What is imported here is light: the score as a value, its JSON, conditions and limits. The functions that compute scores
stand in `trajectory_score`, `cloud_error`, `resource_score` and `build`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
