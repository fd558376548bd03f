"""Worlds, drives, processes and checks that the tests share."""

from pathlib import Path

HELPERS = Path(__file__).resolve().parent
ROOT = HELPERS.parents[1]
