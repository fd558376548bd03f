from .score_run import diagnose_files as diagnose_files
from .score_run import score_files as score_files
