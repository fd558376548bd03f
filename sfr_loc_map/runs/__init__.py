"""Runs of a localiser or mapper, ours or one under test: what a run results in, and its files.

    run                               result                                     files
    ───                               ──────                                     ─────
    offline.run_localiser             DriveRun: PoseEstimate, CallRecord a pair  estimate.csv, stats.csv, video
    offline.run_mapper                MapRun: PairMap a pair, FusedMap, calls    cloud, elevation models, stats.csv

The record of a call of `process` has three forms (`CallRecord` lists the fields that only the first one has):

    CallRecord (`calls`)              one call; as JSON on the topic `<node>/call` (`encode_call`, `decode_call`)
    stats.csv (`call_files`)          one row for each call (`save_stats`, `load_call_stats`)
    CallStats (`call_stats`)          the calls of a run as columns, from records or from a file; scores read this form

`map_files` and `track_video` write the other files.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
