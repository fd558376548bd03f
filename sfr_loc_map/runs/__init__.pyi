from .offline import DriveRun as DriveRun
from .offline import MapRun as MapRun
from .offline import run_localiser as run_localiser
from .offline import run_mapper as run_mapper
from .offline import start_pose as start_pose
