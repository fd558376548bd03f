from .isolated_localiser import IsolatedLocaliser as IsolatedLocaliser
from .isolated_mapper import IsolatedMapper as IsolatedMapper
from .registry import Method as Method
from .registry import MethodLimits as MethodLimits
from .registry import find_method as find_method
from .registry import listed_methods as listed_methods
