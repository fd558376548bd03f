from .running.cluster import connected as connected
from .running.cluster import run_jobs as run_jobs
from .running.plan import make_plan as make_plan
from .running.specification import SuiteSpecification as SuiteSpecification
from .running.specification import load_specification as load_specification
from .running.store import Store as Store
from .statistics.summary import Summary as Summary
from .statistics.summary import summarise as summarise
