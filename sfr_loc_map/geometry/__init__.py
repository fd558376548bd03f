"""Frames, rotations, transforms, cameras, trajectories and clouds: the values that all packages share.

Frames: DS is the frame of the terrain, in which the rover's path is given, and LM the local map. RB is the body of the
rover, DMA the base of its mast, NAVSB the stereo rig for mapping, LOCSB the stereo rig for localisation, and SB either
of these two. Numbers in brackets, such as [3.2.3], are clauses of the specification, called the source document. See
docs/conventions.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
