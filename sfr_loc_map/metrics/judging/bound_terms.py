"""What a requirement with a share and a confidence states besides its bound [ECSS-E-ST-60-10C, 4.1.4.2]."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any, NamedTuple

from sfr_loc_map.metrics.judging.sequential import SequentialTest
from sfr_loc_map.metrics.judging.tolerance import CONFIDENCE, THREE_SIGMA

BOUND = "bound"  #: Statistic of a limit that is judged by a tolerance bound.


class Interpretation(StrEnum):
    """Over what the share of a requirement is taken [ECSS-E-ST-60-10C, 4.1.4.2]."""

    TEMPORAL = "temporal"
    ENSEMBLE = "ensemble"
    MIXED = "mixed"


class Terms(NamedTuple):
    """What a limit requires besides its bound."""

    prob: float = THREE_SIGMA  #: Share of the errors that lie within the limit.
    confidence: float = CONFIDENCE  #: Confidence with which that must be shown.
    interpretation: Interpretation = Interpretation.TEMPORAL
    normal: bool = False  #: Whether errors are declared to be normal, which few values cannot show.
    power: float = CONFIDENCE  #: Probability that drives with the share `good` of failures pass.
    good: float | None = None  #: Share of failures that is acceptable; with it drives are judged by a sequential test.

    @property
    def test(self) -> SequentialTest:
        """The sequential test; a fifth of the share of failures that must not pass is acceptable unless stated."""
        bad = 1.0 - self.prob
        return SequentialTest(bad / 5.0 if self.good is None else self.good, bad, self.confidence, self.power)


def terms_of(entry: Mapping[str, Any]) -> tuple[Terms, str | None]:
    """Return the terms of an entry of a limits file, and what is wrong with them, None for nothing."""
    given = {name: entry[name] for name in Terms._fields if name in entry}
    for name in ("prob", "confidence", "power"):
        value = given.get(name, 0.5)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.5 <= value < 1.0:
            return Terms(), f"'{name}' is {value!r}: a number from 0.5 to below 1 is required, 0.95 for 95 %"
    good = given.get("good", 0.0)
    most = 1.0 - float(given.get("prob", THREE_SIGMA))
    if isinstance(good, bool) or not isinstance(good, (int, float)) or not 0.0 <= good < most:
        return Terms(), f"'good' is {good!r}: a share of failures from 0 to below 1 - prob = {most:g} is required"
    if "normal" in given and not isinstance(given["normal"], bool):
        return Terms(), f"'normal' is {given['normal']!r}: true or false is required"
    word = given.pop("interpretation", Interpretation.TEMPORAL)
    if word not in [str(kind) for kind in Interpretation]:
        return Terms(), f"'interpretation' is {word!r}: {', '.join(Interpretation)} are allowed"
    if "good" in given and word == Interpretation.TEMPORAL:
        return Terms(), "'good' is for drives: it needs the interpretation ensemble or mixed"
    return Terms(**given)._replace(interpretation=Interpretation(word)), None
