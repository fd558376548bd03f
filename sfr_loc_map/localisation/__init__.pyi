from .config import LocalisationConfig as LocalisationConfig
from .estimate import PoseEstimate as PoseEstimate
from .estimate import TrackingState as TrackingState
from .estimate import TrackingStatistics as TrackingStatistics
from .localiser import Localiser as Localiser
