"""Evidence from a recording without ground truth: agreement of runs that should agree.

`recording.check_recording` checks the drive and the maps of a source:

    source ─┬─ drive ── check.check_drive ──┬── RecordingCheck ── cli.check, check_tables
            └─ maps ─── overlap.check_maps ─┘

`check_drive` runs the localiser several times over the drive and compares the runs:

- runs: `variants` runs the localiser forward, backward, over every second pair, and with the landmarks of one half of
  the image. `paired_runs` restricts two runs to their common pairs.
- evidence that decides the result: `agreement` compares two runs over sub-trajectories, and `revisited` compares the
  accumulated motion with a direct run between two visits of a place.
- further figures: `predicted` (error by source), `other_estimates` (wheel odometry) and `calibration` (right camera).

Each of these modules returns its figures as rows of the table of figures. `kinds` lists the kinds of evidence, with the
statistic of each, what it shows and what it hides. `check_result` defines the results (`CheckResult`) and how they are
combined. `derived_results` derives the results of a stored check again from its figures.
"""
