from .config import MappingConfig as MappingConfig
from .elevation import ElevationModel as ElevationModel
from .elevation import elevation_from_cloud as elevation_from_cloud
from .elevation import point_covariances as point_covariances
from .mapper import FusedMap as FusedMap
from .mapper import Mapper as Mapper
from .mapper import PairMap as PairMap
