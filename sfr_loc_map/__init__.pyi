from .api import PointCloud as PointCloud
from .api import Score as Score
from .api import Source as Source
from .api import Trajectory as Trajectory
from .api import localise as localise
from .api import map as map
from .api import open as open
from .api import score as score
from .localisation import Localiser as Localiser
from .mapping import Mapper as Mapper

__version__: str
