"""A ray-traced, Mars-like world: terrain, light, drive and sensor, with exact ground truth.

    SimulationConfig (config.py)
      Plan (plan.py)          the ground as a function of position (terrain.py), the drive over it (drive.py, rover.py),
                              poses and stamps of the cameras
      World (world.py)        the scene: triangles of the ground (ground_mesh.py) and of the rocks (rocks.py)
        image                 rays of each pixel and their hits (tracer.py), surfaces (surface.py, pebbles.py) and
                              their brightness (shading.py), grey levels (sensor.py)
        truth                 points and masks of a mapping image, from the same rays and hits
      simulate.py             writes a data set folder; each image is a job (jobs.py, workers.py), so that a run can be
                              continued

`noise.py` contains all random numbers that depend on a position, and the keys of all random streams.

To add a setting of a scenario, add a field with unit, range and description to `config.py`, and use the setting in one
of the modules above. A kernel receives the setting as a field of its NamedTuple.
`test/simulation/test_config.py` fails if a setting has no effect on the files. The page docs/simulation.md lists the
numbers that are not settings, with their sources.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
