"""Deviations of the results of a suite: each sentence once, with the number of results to which it applies."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import msgspec
from msgspec import Struct

from sfr_loc_map.report.deviations import deviations_of
from sfr_loc_map.suite.statistics.scored_job import ScoredJob, undeclared_items_in

NUMBER = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")  #: A number in a sentence.


class CommonDeviation(Struct, frozen=True, kw_only=True):
    """A deviation of one or more results from the specification, or data of these results that are not judged."""

    text: str  #: The deviation of the result with the largest number in the text.
    results: int  #: Number of results with this deviation.
    of: str  #: Label of the result whose deviation is `text`.


def common_deviations(results: Sequence[ScoredJob]) -> tuple[CommonDeviation, ...]:
    """Return the deviations of all results, and a deviation if several results do not name their item under test.

    Sentences that differ only in numbers are one deviation.
    """
    found: dict[str, CommonDeviation] = {}
    for result in results:
        sentences = {_without_numbers(text): text for text in deviations_of(result.score)}
        for kind, text in sentences.items():
            item = CommonDeviation(text=text, results=1, of=result.job.label)
            if (known := found.get(kind)) is not None:
                largest = max(known, item, key=lambda each: _largest_number(each.text))
                item = msgspec.structs.replace(largest, results=known.results + 1)
            found[kind] = item
    return (*_unnamed_items(results), *_several_items(results), *found.values())


def _unnamed_items(results: Sequence[ScoredJob]) -> Iterator[CommonDeviation]:
    """Yield a deviation if several results do not name their item under test, because their items may differ."""
    unnamed = [result for result in results if result.score.method is None]
    if len(unnamed) > 1:
        text = "The results do not name their item under test. Their items may differ (the calls name the item)."
        yield CommonDeviation(text=text, results=len(unnamed), of=unnamed[0].job.label)


def _several_items(results: Sequence[ScoredJob]) -> Iterator[CommonDeviation]:
    """Yield a deviation that names the items under test if the suite does not declare all of them."""
    if items := undeclared_items_in(results):
        text = f"The results come from several items under test or configurations: {', '.join(items)}."
        yield CommonDeviation(text=text, results=len(results), of="all results")


def _without_numbers(text: str) -> str:
    """Return a text with 0 in place of each number, by which deviations of several results are compared."""
    return NUMBER.sub("0", text)


def _largest_number(text: str) -> float:
    """Return the largest number in a text, 0 without one."""
    return max((float(match[0]) for match in NUMBER.finditer(text)), default=0.0)
