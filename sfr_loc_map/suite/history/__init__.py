"""Changes of the figures of a suite over many nights: each night is one run of the suite.

night.py             reads `suite.json` of each night
history.py           finds the changes of each figure: History
night_changes.py     compares each night of a figure with the nights before
night_comparison.py  makes one comparison, over all jobs and for each job
"""
