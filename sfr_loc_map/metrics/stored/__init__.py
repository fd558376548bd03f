"""Scores as files: their JSON, the check that a stored score does not contradict itself, and comparisons.

`score_json` reads and writes a score. `file_check` checks its rows and derives the verdicts again. `comparison`
compares several scores of the same data.
"""
