"""Evidence from a recording without ground truth: agreement of runs that should agree. `check.py` lists its kinds."""
