from .cluster import connected as connected
from .cluster import run_jobs as run_jobs
from .plan import make_plan as make_plan
from .specification import SuiteSpecification as SuiteSpecification
from .specification import load_specification as load_specification
from .store import Store as Store
from .summary import Summary as Summary
from .summary import summarise as summarise
