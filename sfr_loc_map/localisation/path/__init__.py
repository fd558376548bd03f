"""The path of the rover: its poses so far with their accumulated errors, and how each event changes them.

    pair (accepted, kept, lost, first of a window) ----> trajectory ------+
    adjustment of a keyframe --------------------------> trajectory ------+--> PathState, step to the published pose
    external pose (start of the run, or set later) ----> external_poses --+

| module | content |
|---|---|
| `path_state` | the state: last pose, datum, accumulated errors, pose published last, past poses |
| `trajectory` | the change of the state by each kind of pair, and by the adjustment of a keyframe |
| `external_poses` | the change of the state by external poses: to which pose they apply, and when |
| `history` | past poses, to which external poses with past stamps apply |

All values are immutable. The covariances are computed by `uncertainty`, and the initial guesses of the next pose by
`motion_model`.
"""
