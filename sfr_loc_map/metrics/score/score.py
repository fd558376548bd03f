"""The score: a table of figures, a table of verdicts, and records of how both were made.

A row of figures is defined in `metrics.figures.rows`, a verdict in `metrics.score.verdict`, the records in
`metrics.figures.records`, and the data of the plots in `metrics.figures.details`.

`Score.figure` finds a row of the table: `score.figure("position", condition="distance=5")`. msgspec writes and reads
the JSON (`sfr-score/2`, `metrics.stored.score_json`). A field has the same name in the JSON, unless its declaration
states another name (`Verdict.state` is `verdict`, `Limit.section` is `part`). Fields that do not apply are null or
omitted. The comments of the fields are the reference of the JSON (docs/reference/score.md). Numbers
in brackets are clauses of the specification. N is the start of a sub-trajectory, N+x its end.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from sfr_loc_map.errors import ConfigError
from sfr_loc_map.geometry.arrays import FloatArray
from sfr_loc_map.metrics.conditions import Condition
from sfr_loc_map.metrics.config import VerdictState
from sfr_loc_map.metrics.figures.details import Details, ErrorRows
from sfr_loc_map.metrics.figures.records import (
    Alignment,
    Association,
    CallRecords,
    CloudRecord,
    ConventionRecord,
    ExternalScore,
    FindingRecord,
    MethodRecord,
    ProcessUsage,
    Provenance,
    Record,
    TargetRun,
    TruthRecord,
)
from sfr_loc_map.metrics.figures.row_part import ANY, POOLED
from sfr_loc_map.metrics.figures.rows import Figure, find_rows
from sfr_loc_map.metrics.figures.subjects import Subject
from sfr_loc_map.metrics.score.limits import Limits
from sfr_loc_map.metrics.score.verdict import Verdict

SCHEMA = "sfr-score/2"
JUDGED_ROW = "*judged row"  #: Default of `part` in `Score.figure`, which selects the judged row. No part has this text.


def written(default: Any) -> Any:  # noqa: ANN401 - the type of the field, as in msgspec.field
    """Declare a field that is always written, as null or empty if it is unknown."""
    return msgspec.field(default_factory=lambda: default)


class Score(Record, frozen=True, kw_only=True, tag_field="schema", tag=SCHEMA):
    """The score of a run."""

    #: Verdict over all limits; null if nothing is judged. Without limits: `incomplete`, `fail` (fatal finding) or null.
    verdict: VerdictState | None = written(None)
    figures: tuple[Figure, ...] = written(())  #: The table of figures.
    #: Verdicts on findings and on missing data, then one verdict for each limit in the order of the limits.
    verdicts: tuple[Verdict, ...] = written(())
    association: Association | None = written(None)  #: How estimates were associated with the ground truth.
    truth: TruthRecord | None = written(None)  #: Properties of the ground truth of the trajectory.
    provenance: Provenance | None = written(None)  #: Inputs and software that the score was made with.
    alignment: Alignment | None = None  #: How APE and RPE were computed; null if they were not requested.
    cloud: CloudRecord | None = None  #: How a cloud was compared with the ground truth.
    calls: CallRecords | None = None  #: How times and memory were measured on this host.
    target: TargetRun | None = None  #: The target on which calls were measured.
    method: MethodRecord | None = None  #: The method under test; null if the inputs do not name it.
    findings: tuple[FindingRecord, ...] = ()  #: Faults of the method under test, one record for each kind.
    processes: ProcessUsage | None = None  #: Resources used by the processes of the method; null if it has none.
    external: ExternalScore | None = None  #: How an external node behaved; null without an external node.
    convention: ConventionRecord | None = None  #: How the poses were converted before they were scored.
    warnings: tuple[str, ...] = ()  #: Warnings, one line each.
    #: The warnings that are deviations of a test report: what the score omits, did not compare or weights unevenly.
    caveats: tuple[str, ...] = ()
    contradiction: str | None = None  #: Convention mismatch of estimate and truth, because of which nothing is judged.
    incomplete: str | None = None  #: Expected data that cannot be judged; null if there are none.
    #: Rules by which the verdicts follow from the figures; null without limits and partial judging.
    rules: Limits | None = None
    errors: tuple[ErrorRows, ...] = ()  #: All errors of the figures whose tolerance bound is limited.
    details: Details | None = None  #: Data of the plots.
    content_sha256: str | None = None  #: Hash of all other values of a file; null for a score in memory.

    def rows(
        self, figure: str = ANY, *, subject: str = ANY, condition: str | Condition | None = ANY, part: str | None = ANY
    ) -> list[Figure]:
        """Return the rows of the table of figures that have these keys, in the order of the table.

        ConfigError if neither the catalogue nor the table has this figure. MetricsError if the condition is invalid.
        """
        return list(find_rows(self.figures, figure, subject=subject, condition=condition, part=part))

    def figure(
        self, figure: str, *, subject: str = ANY, condition: str | Condition | None = ANY, part: str | None = JUDGED_ROW
    ) -> Figure | None:
        """Return the row of a figure and a part, or without `part` the judged row; None if there is no such row.

        Without `condition` the first condition is used. The parts of a figure depend on the run, so an unknown `part`
        is not an error. ConfigError if neither the catalogue nor the table has this figure, or, naming the available
        parts, if `part` is not given and no row of the figure is judged. MetricsError if the condition is invalid.
        """
        if part != JUDGED_ROW:
            return next(find_rows(self.figures, figure, subject=subject, condition=condition, part=part), None)
        row = self.judged_row(figure, subject=subject, condition=condition)
        if row is None and (rows := self.rows(figure, subject=subject, condition=condition)):
            parts = ", ".join(dict.fromkeys(str(row.part) for row in rows))
            raise ConfigError(f"figure '{figure}' has no row without a part: give part=, one of {parts}")
        return row

    def judged_row(self, figure: str, *, subject: str = ANY, condition: str | Condition | None = ANY) -> Figure | None:
        """Return the judged row of a figure; None if no row is judged. Without `condition` the first condition is used.

        Errors of sub-trajectories are judged by one reading of the specification (`association.reading`), and in a
        suite over all drives (part `pooled`). For every other figure the row without a part is judged.
        """
        reading = self.reading
        for row in self.rows(figure, subject=subject, condition=condition):
            is_of_sub_trajectories = row.subject is Subject.TRAJECTORY and row.condition is not None
            if row.part in ((reading, POOLED) if is_of_sub_trajectories else (None,)):
                return row
        return None

    def is_judged_row(self, row: Figure) -> bool:
        """Return whether a row of this score is the judged row of its figure and its condition."""
        judged = self.judged_row(row.figure, condition=row.condition)
        return judged is not None and judged.keys == row.keys

    def number(
        self,
        figure: str,
        statistic: str = "value",
        *,
        subject: str = ANY,
        condition: str | Condition | None = ANY,
        part: str | None = JUDGED_ROW,
    ) -> float | None:
        """Return one statistic of a figure, None if it is undefined or there is no such row, as for an unknown part.

        ConfigError if there is no such statistic. The errors of `figure` are raised as well.
        """
        row = self.figure(figure, subject=subject, condition=condition, part=part)
        return None if row is None else row.statistic(statistic)

    def index_of(self, row: Figure | None) -> int | None:
        """Return the index of the row that has the keys of a row of this score, None for no row."""
        return None if row is None else [other.keys for other in self.figures].index(row.keys)

    def row_of(self, verdict: Verdict) -> Figure | None:
        """Return the row that a verdict of this score judges, None if the verdict has no row."""
        return None if verdict.row is None else self.figures[verdict.row]

    def is_about(self, verdict: Verdict, row: Figure) -> bool:
        """Return whether a verdict of this score judges a row of this score."""
        judged = self.row_of(verdict)
        return judged is not None and judged.keys == row.keys

    def all_errors(self, figure: str, condition: str | None) -> FloatArray | None:
        """Return all errors `(n, d)` of a figure, NaN if unknown; None if the score does not have them (`errors`).

        The data of the plots are not used, because they are rounded and may be decimated.
        """
        names = (figure, condition)
        columns = next((item.errors for item in self.errors if (item.figure, item.condition) == names), ())
        return np.stack([np.array(values, np.float64) for values in columns], axis=1) if columns else None

    def has(self, subject: str) -> bool:
        """Return whether there is a figure about a subject."""
        return any(row.subject == subject for row in self.figures)

    @property
    def conditions(self) -> tuple[str, ...]:
        """The conditions of sub-trajectories, in the order of the table."""
        return tuple(dict.fromkeys(row.condition for row in self.rows("position") if row.condition is not None))

    @property
    def reading(self) -> str | None:
        """The reading of the requirements document that the verdicts use; None without a trajectory."""
        return None if self.association is None else str(self.association.reading)

    @property
    def active_rules(self) -> Limits:
        """The rules of the score. If the score has no rules: the default rules, which have no limits."""
        return Limits() if self.rules is None else self.rules

    @property
    def fatal_findings(self) -> tuple[FindingRecord, ...]:
        """The findings that prevent a pass."""
        return tuple(item for item in self.findings if item.kind.fails)

    @property
    def on_limits(self) -> tuple[Verdict, ...]:
        """The verdicts on limits, which follow those on findings and on missing data."""
        count = len(self.active_rules.limits)
        return self.verdicts[len(self.verdicts) - count :]

    @property
    def missed(self) -> tuple[Verdict, ...]:
        """The verdicts that are `fail`."""
        return tuple(item for item in self.verdicts if item.state is VerdictState.FAIL)

    @property
    def is_judged(self) -> bool:
        """Whether the score has a verdict, or a reason why it has none."""
        return bool(self.verdicts) or self.incomplete is not None or self.contradiction is not None

    def with_caveat(self, text: str) -> Score:
        """Return the score with another caveat, which is also a warning."""
        return msgspec.structs.replace(self, warnings=(*self.warnings, text), caveats=(*self.caveats, text))
