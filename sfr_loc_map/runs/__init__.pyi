from .calls import CallRecord as CallRecord
from .offline import MapRun as MapRun
from .offline import localise as localise
from .offline import map_pairs as map_pairs
from .offline import start_pose as start_pose
