from .drive_start import start_pose as start_pose
from .localiser_run import DriveRun as DriveRun
from .localiser_run import run_localiser as run_localiser
from .mapper_run import MapRun as MapRun
from .mapper_run import run_mapper as run_mapper
