"""Limits of a requirements file and the verdicts on them."""
