"""Scores as files: their JSON, and the check that a stored score does not contradict itself.

`score_json` reads and writes a score. `file_check` checks its rows and derives the verdicts again.
"""
