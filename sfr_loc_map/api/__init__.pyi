from .cloud import PointCloud as PointCloud
from .runs import localise as localise
from .runs import map as map
from .score_result import Score as Score
from .scoring import score as score
from .source import Source as Source
from .source import open as open
from .trajectory import Trajectory as Trajectory
