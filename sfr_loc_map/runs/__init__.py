"""Runs of our localiser or mapper, or of a method under test, over a complete source: results and files of a run.

    run                               result                                       files
    ───                               ──────                                       ─────
    localiser_run.run_localiser       DriveRun: PoseEstimate, CallRecord per pair  estimate.csv, stats.csv, video
    mapper_run.run_mapper             MapRun: PairMap per pair, FusedMap, calls    cloud, elevation models, stats.csv

Both take the configuration of our localiser or mapper, or a method under test (`under_test`). `drive_start` returns the
pose at which a drive starts. `calls.call_files` writes stats.csv. `map_files` (elevation models: `geotiff`) and
`track_video` write the other files.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
