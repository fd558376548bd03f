"""What a source contains (`sfr info`), and the files that describe it (`sfr info --write`, `sfr init`).

The files are an inferred sfr.yaml, initial parameters and limits.
"""
