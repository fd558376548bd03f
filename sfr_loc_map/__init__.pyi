from .api import localise as localise
from .api import map as map
from .api import open as open
from .api import score as score
from .geometry.cloud import PointCloud as PointCloud
from .geometry.trajectory import Trajectory as Trajectory
from .io.sequence import Source as Source
from .localisation import Localiser as Localiser
from .mapping import Mapper as Mapper
from .metrics.score import Score as Score

__version__: str
