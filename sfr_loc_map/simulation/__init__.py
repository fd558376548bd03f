"""A ray-traced world like Mars: terrain, light, drive and sensor, with exact truth; faults for any recording.

The faults (`faults`, `perturber`, `faulty_source`) change the pairs of a source and do not use the world.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
