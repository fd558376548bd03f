"""Scores as files: their JSON, the check that a stored score does not contradict itself, and comparisons.

`score_json` reads and writes a score. `file_check` derives figures and verdicts again, with `raw_values` and
`related_rows` for the figures. `comparison` compares several scores of the same data.
"""
