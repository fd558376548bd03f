"""Runs of a localiser or mapper, ours or one under test: calls, results and their files.

`offline` runs over a complete source; its entry points are `run_localiser` and `run_mapper`. `calls` has the record of
each call, also for the topic `<node>/call`, and `call_stats` has the calls of a run as columns. `replay_result` has the
results of a replay through the nodes. Files are written by `call_files`, `map_files`, `replay_files` and `track_video`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
