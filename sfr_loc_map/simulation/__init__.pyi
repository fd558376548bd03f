from .config import SimulationConfig as SimulationConfig
from .faults import Fault as Fault
from .faults import FaultKind as FaultKind
from .faults import parse_fault as parse_fault
from .perturber import Perturber as Perturber
from .world import World as World
