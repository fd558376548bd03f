"""False alarms and detections of `sfr suite history`, and the delay of detections, on simulated histories.

python -m campaigns history-power [--histories 2000] [--seed 1]

Drives differ from each other and from night to night. In some nights the host is busy, some commits shift each drive
permanently by a small amount, and some runs fail by chance. The parameters were not tuned to the results.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from sfr_loc_map.suite.history.history import FALSE_ALARM_RATE
from sfr_loc_map.suite.history.scales import SCALES
from sfr_loc_map.suite.history.shifts import find_shifts
from sfr_loc_map.suite.statistics.figures import ComparedKind

DRIVES = 45
LENGTHS = {20: 13, 200: 100, 400: 300}  #: Night of the change by nights of the history.
ERRORS = ("position", "attitude", "heading")
Table = Mapping[str, np.ndarray]


def log_normal(rng: np.random.Generator, nights: int, drive: float, common: float, code: float) -> np.ndarray:
    """Return relative values `(D, T)` with deviations of drives, of nights, and of a commit in one of five nights."""
    own = drive * np.exp(rng.normal(0.0, 0.5, (DRIVES, 1)))  # drives are not equally repeatable
    tails = rng.standard_t(5, (DRIVES, nights)) / np.sqrt(5.0 / 3.0)
    commits = rng.normal(0.0, code, (DRIVES, nights)) * (rng.random(nights) < 0.2)
    return np.exp(own * tails + rng.normal(0.0, common, nights) + np.cumsum(commits, axis=1))


def simulated(rng: np.random.Generator, nights: int) -> dict[str, np.ndarray]:
    """Return the figures of a history `(D, T)` without a change."""
    level = np.exp(rng.normal(-4.0, 0.7, (DRIVES, 1)))
    errors = {name: level * log_normal(rng, nights, 0.04, 0.005, 0.005) for name in ERRORS}
    busy = 1.0 + rng.exponential(0.15, nights) * (rng.random(nights) < 0.02)
    host = np.exp(0.03 * rng.standard_t(5, nights)) * busy
    rate = rng.gamma(0.5, 1.0, (DRIVES, 1))
    alone = rng.random((DRIVES, nights)) < 0.003
    of_host = rng.random((DRIVES, nights)) < (2.0 / DRIVES) * (rng.random(nights) < 0.01)
    return errors | {
        ComparedKind.NEES: log_normal(rng, nights, 0.1, 0.01, 0.01),
        ComparedKind.LOST: rng.poisson(rate * rng.gamma(2.0, 0.5, (DRIVES, nights))) * 1.0,
        ComparedKind.DEGRADED: rng.poisson(4.0 * rate * rng.gamma(2.0, 0.5, (DRIVES, nights))) * 1.0,
        ComparedKind.MISSING: rng.poisson(0.1, (DRIVES, nights)) * 1.0,
        ComparedKind.FAILED: (alone | of_host) * 1.0,
        ComparedKind.TIME: 0.1 * host * log_normal(rng, nights, 0.02, 0.0, 0.002),
        ComparedKind.MEMORY: 4e8 * log_normal(rng, nights, 0.005, 0.003, 0.001),
    }


def times(factor: float, drives: int, *figures: str) -> Callable[[dict[str, np.ndarray], int], None]:
    """Return a function that multiplies figures of the first drives from a night on."""

    def change(history: dict[str, np.ndarray], night: int) -> None:
        for figure in figures:
            history[figure][:drives, night:] *= factor

    return change


def grows(factor: float, *figures: str) -> Callable[[dict[str, np.ndarray], int], None]:
    """Return a function that multiplies figures of all drives in each night by one more factor, from a night on."""

    def change(history: dict[str, np.ndarray], night: int) -> None:
        for figure in figures:
            since = np.maximum(np.arange(history[figure].shape[1]) - night + 1, 0)
            history[figure] *= factor**since

    return change


def more_lost(history: dict[str, np.ndarray], night: int) -> None:
    history[ComparedKind.LOST][:, night:] += 8.0


def failures(history: dict[str, np.ndarray], night: int) -> None:
    history[ComparedKind.FAILED][:15, night:] = 1.0


CHANGES: Mapping[str, tuple[Callable[[dict[str, np.ndarray], int], None], tuple[str, ...]]] = {
    "all drives 1.1 times worse": (times(1.1, DRIVES, *ERRORS), ERRORS),
    "three drives 5 times worse": (times(5.0, 3, *ERRORS), ERRORS),
    "one drive 10 times worse": (times(10.0, 1, *ERRORS), ERRORS),
    "8 more frames lost": (more_lost, (ComparedKind.LOST,)),
    "15 drives without a result": (failures, (ComparedKind.FAILED,)),
    "calls 1.3 times slower": (times(1.3, DRIVES, ComparedKind.TIME), (ComparedKind.TIME,)),
    "NEES 2 times larger": (times(2.0, DRIVES, ComparedKind.NEES), (ComparedKind.NEES,)),
    "all drives 1 % worse each night": (grows(1.01, *ERRORS), ERRORS),
    "memory 1.2 times larger": (times(1.2, DRIVES, ComparedKind.MEMORY), (ComparedKind.MEMORY,)),
}


@dataclass
class Tally:
    """Results of the histories of one kind and length."""

    histories: int = 0
    delays: list[int] = field(default_factory=list)
    located: int = 0
    named: int = 0


def main(arguments: list[str]) -> int:
    """Print the tables; exit code 1 if there is more than one false alarm per year."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--histories", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    cases = [(kind, length) for kind in CHANGES for length in LENGTHS] + [("none", length) for length in LENGTHS] * 4
    tallies: dict[tuple[str, int], Tally] = {}
    nights, wrong, by_figure = Counter[str](), Counter[str](), Counter[str]()
    for number in range(options.histories):
        kind, length = cases[number % len(cases)]
        rng, night = np.random.default_rng([options.seed, number]), LENGTHS[length] - 1
        history = simulated(rng, length)
        apply, changed = CHANGES.get(kind, (None, ()))
        if apply is not None:
            apply(history, night)
        tally = tallies.setdefault((kind, length), Tally())
        tally.histories += 1
        first: list[tuple[int, bool, bool]] = []
        nights["none" if apply is None else "changed"] += length
        for name, values in history.items():
            scale = SCALES[ComparedKind.ACCURACY if name in ERRORS else ComparedKind(name)]
            before = None
            for found in find_shifts(scale.apply(values), scale, FALSE_ALARM_RATE / len(history)):
                detected = found.nights.after.stop - 1
                is_return = before is not None and found.nights.before == before.nights.after
                before = found
                if name in changed and detected >= night and not any(item[0] < detected for item in first):
                    true = {"three drives 5 times worse": 3, "one drive 10 times worse": 1}.get(
                        kind, 15 if name == ComparedKind.FAILED else DRIVES
                    )
                    named = set(found.jobs) if len(found.jobs) < found.of else set(range(DRIVES))
                    right = (
                        len(named & set(range(true))) >= 0.8 * true and len(named - set(range(true))) <= 1 + 0.1 * true
                    )
                    first.append((detected, found.night == night, right))
                elif not is_return and (name not in changed or detected < night):
                    wrong["none" if apply is None else "changed"] += 1
                    by_figure[str(name)] += 1
        if first:
            soonest = min(first)
            tally.delays.append(soonest[0] - night + 1)
            tally.located += soonest[1]
            tally.named += soonest[2]
    print("| change | nights | found | needed, median | needed, 90 % | night named | drives named |")
    print("|---|---|---|---|---|---|---|")
    for (kind, length), tally in tallies.items():
        if kind != "none":
            n = max(1, len(tally.delays))
            median, most = np.quantile(tally.delays or [np.nan], (0.5, 0.9), method="higher")
            share = 100 * len(tally.delays) / tally.histories
            print(
                f"| {kind} | {length} | {share:.0f} % of {tally.histories} | {median:g} | {most:g} | "
                f"{100 * tally.located / n:.0f} % | {100 * tally.named / n:.0f} % |"
            )
    for kind, count in nights.items():
        rate = 365.0 * wrong[kind] / count
        print(f"false alarms, histories with a change '{kind}': {wrong[kind]} in {count} nights, {rate:.3f} a year")
    print("by figure:", dict(by_figure))
    return int(365.0 * sum(wrong.values()) > sum(nights.values()))
