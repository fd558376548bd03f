"""A job of a suite with its score, judged by the limits of the suite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from sfr_loc_map.metrics.judging.judge import judged_by
from sfr_loc_map.metrics.judging.limited import limits_about, tasks_of
from sfr_loc_map.metrics.judging.several_scores import undeclared_items
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.score import Score
from sfr_loc_map.metrics.stored.score_json import to_plain
from sfr_loc_map.suite.jobs.job import DriveOrder, Job, JobTask
from sfr_loc_map.suite.jobs.job_outcome import JobState
from sfr_loc_map.suite.statistics.figures import figures_of
from sfr_loc_map.suite.store import Store


@dataclass(frozen=True)
class ScoredJob:
    """A job with its score."""

    job: Job
    score: Score

    @cached_property
    def drive_key(self) -> str:
        """`Job.drive_key`, which repeats and copies of a drive share."""
        return self.job.drive_key

    @cached_property
    def drive_order(self) -> DriveOrder:
        """`Job.drive_order`."""
        return self.job.drive_order

    @property
    def position_m(self) -> float | None:
        """Mean + 3 sigma of the position error of the first condition, m; None without a trajectory."""
        return self.score.number("position", "mean_plus_3sigma")

    def names(self) -> dict[str, object]:
        """Return the names of the job as JSON values."""
        job = self.job
        return {
            "key": job.key,
            "label": job.label,
            "task": job.task.value,
            "source": job.source.name,
            "configuration": job.configuration,
            "faults": job.faults,
            "variant": job.variant,
            "seed": job.seed,
            "repeat": job.repeat,
        }

    def to_dict(self) -> dict[str, object]:
        """Return names, figures and verdicts of the result, and the file of its score, as JSON values."""
        content = self.names() | {
            "path": self.job.source.path,
            "pairing": self.job.pairing,
            "file": f"results/{self.job.key}.json",
            "figures": [[item.kind, item.name, value] for item, value in figures_of(self.score).items()],
            "verdicts": to_plain(self.score.verdicts),
        }
        for name in ("incomplete", "contradiction", "findings"):
            if value := getattr(self.score, name):
                content[name] = to_plain(value)
        return content


class ResultReader:
    """Reads the results of a suite, and judges them by limits. Each result is read once."""

    def __init__(self, store: Store, limits: Limits | None) -> None:
        self.limits = limits
        self._store = store
        self._read: dict[str, ScoredJob] = {}  # by key of the job

    def results_of(self, jobs: Sequence[Job]) -> list[ScoredJob]:
        """Return the results of those jobs that have one, in the order of the jobs.

        InputError if a result cannot be read, or if a result is not that of its job.
        """
        found = []
        for job in jobs:
            key = job.key  # a hash of all inputs
            if key not in self._read and self._store.state(job) is JobState.DONE:
                self._read[key] = self._judged(job)
            if key in self._read:
                found.append(self._read[key])
        return found

    def _judged(self, job: Job) -> ScoredJob:
        """Return the result of a job, judged by the limits that apply to its subjects."""
        score = self._store.score(job)
        of_score = limits_about(self.limits, tasks_of(score))
        return ScoredJob(job, judged_by(score, of_score, partial=job.scoring.partial))


def undeclared_items_in(results: Sequence[ScoredJob]) -> tuple[str, ...]:
    """Return the names of the items under test if a given estimate has another item than the other results.

    The item of a given estimate (`JobTask.SCORE`) is not declared by a configuration of the suite.
    """
    undeclared = [result.score for result in results if result.job.task is JobTask.SCORE]
    declared = [result.score for result in results if result.job.task is not JobTask.SCORE]
    return undeclared_items(undeclared, declared)
