"""Frames, rotations, transforms, cameras, trajectories and clouds: the values that all packages share.

The modules, each after the modules that it imports:

| module | contents |
|---|---|
| `arrays` | array types, and fast functions of small arrays |
| `robust_statistics` | scale and weight that are insensitive to outliers |
| `plausibility` | bounds of cameras and poses from files, topics and parameters |
| `rotation`, `transform` | rotations; rigid transforms `T_a_b`, and the propagation of their covariances |
| `camera` | cameras and poses as named tuples, which numba kernels accept |
| `stereo` | rectified stereo rig and its image pairs |
| `frame_tree`, `extrinsics` | frames of `/tf_static`, and the pose of a rig on the rover from these frames |
| `trajectory`, `stamped_poses` | stamped poses, and the interpolation between them |
| `cloud` | point clouds |

Frames: DS is the frame of the terrain, in which the rover's path is given, and LM the local map. RB is the body of the
rover, and DMA the base of its mast. NAVSB is the stereo rig for mapping, LOCSB the stereo rig for localisation, and SB
stands for either rig. Numbers in brackets, such as [3.2.3], are clauses of the specification (the source document). See
docs/conventions.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
