from .api import localise as localise
from .api import map as map
from .api import open as open
from .api import score as score
from .api_types import PointCloud as PointCloud
from .api_types import Score as Score
from .api_types import Source as Source
from .api_types import Trajectory as Trajectory
from .errors import SfrError as SfrError
from .geometry import PosedStereoPair as PosedStereoPair
from .geometry import StereoPair as StereoPair
from .geometry import StereoRig as StereoRig
from .geometry import Transform as Transform
from .localisation import LocalisationConfig as LocalisationConfig
from .localisation import Localiser as Localiser
from .localisation import PoseEstimate as PoseEstimate
from .localisation.estimate import StartPose as StartPose
from .mapping import Mapper as Mapper
from .mapping import MappingConfig as MappingConfig

__version__: str
