from .competitors import Competitors as Competitors
from .fault_benchmark import benchmark_faults as benchmark_faults
from .fault_campaign import run_campaign as run_campaign
from .localisation_benchmark import benchmark_localisation as benchmark_localisation
from .mapping_benchmark import benchmark_mapping as benchmark_mapping
from .score_benchmark import benchmark_score as benchmark_score
