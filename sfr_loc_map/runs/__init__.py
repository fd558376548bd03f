"""Runs of a localiser or mapper over a complete source, ours or one under test: what a run results in, and its files.

    run                               result                                     files
    ───                               ──────                                     ─────
    offline.run_localiser             DriveRun: PoseEstimate, CallRecord a pair  estimate.csv, stats.csv, video
    offline.run_mapper                MapRun: PairMap a pair, FusedMap, calls    cloud, elevation models, stats.csv

`calls.call_files` writes stats.csv. `map_files` and `track_video` write the other files.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
