from .injector import FaultInjector as FaultInjector
from .kinds import Fault as Fault
from .kinds import FaultKind as FaultKind
from .kinds import parse_fault as parse_fault
