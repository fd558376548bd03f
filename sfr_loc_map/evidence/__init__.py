"""Evidence from a recording without ground truth: agreement of runs that should agree.

`recording.py` checks a complete recording. `check.py` checks its drive and lists the kinds of evidence.
"""
