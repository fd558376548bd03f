"""Pairing of the jobs of several suites by their work and data, and by their configuration if a suite has several."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class PairKey(NamedTuple):
    """Identity of a job among several suites."""

    pairing: str  #: Hash of work and data (`Job.pairing`).
    configuration: str  #: Name of the configuration; empty if each suite has only one.


def have_one_configuration(suites: Iterable[Iterable[PairKey]]) -> bool:
    """Return whether each suite has only one configuration, whose name may then differ between the suites."""
    return all(len({key.configuration for key in keys}) < 2 for keys in suites)


def without_configuration(key: PairKey) -> PairKey:
    """Return the key of a job of a suite with one configuration."""
    return key._replace(configuration="")
