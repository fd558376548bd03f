from .conversion import diagnose_run as diagnose_run
from .score_run import score_files as score_files
