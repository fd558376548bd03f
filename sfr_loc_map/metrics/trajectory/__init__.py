"""The score of a trajectory: two trajectories become frames, sub-trajectories, errors and rows [4.1, 4.2.3].

`trajectory_score.score_trajectory` has the steps in their order. It associates estimates with true poses (package
`frames`), selects sub-trajectories, computes their errors (`metrics.formulas`) and summarises the errors as rows:

- `trajectory_errors`: the sub-trajectories of a condition, the rows of their errors, and the confidence of these rows
- `other_frames`: errors at frames at which no selected sub-trajectory starts or ends
- `standing`: sub-trajectories of a stationary and of a moving rover
- `consistency`: test of the covariance (NEES)
- `truth_error`: error of the truth
- `plot_columns`: data of the plots

`aligned_error` has APE and RPE, which the specification does not define.
"""
