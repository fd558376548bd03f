from .config import SimulationConfig as SimulationConfig
from .world import World as World
