"""Evidence beside the scores: agreement of runs over a recording without ground truth, and evidence in a test report.

`recording.check_recording` checks the drive and the maps of a source:

    source ─┬─ drive ── check.check_drive ──┬── check_result.Check ─┬─ check_tables ── cli.check
            └─ maps ─── overlap.check_maps ─┘                       └─ JSON ── report_evidence ── test report

`check_drive` runs the localiser several times over the drive and compares the runs:

- runs: `localiser_runs` runs the localiser forward, backward, over every second pair, and with the landmarks of one
  half of the image. `paired_runs` restricts two runs to their common pairs.
- comparisons: `agreement` compares two runs over sub-trajectories, and `revisited` compares the accumulated motion with
  a direct run between two visits of a place.
- `calibration` estimates the rotation of the right camera from the runs.
- further figures: `predicted` (error by source) and `other_estimates` (wheel odometry, other methods).

Each of these modules returns its figures as rows of the table of figures. The results of a `Check` follow from these
rows and from the advice for the calibration file. `kinds` lists the kinds of evidence, with the statistic of each, what
it shows and what it hides.

`report_evidence` also reads the error budget of a suite and a search for the worst case.
"""
