"""The errors of the trajectory [4.1, 4.2.3] and of the cloud [4.3.4] as rows of the table of figures.

`trajectory_score` makes the score of the trajectory from the rows of these modules:

- `trajectory_errors`: selection of the sub-trajectories, and their errors
- `other_frames`: errors at frames at which no judged sub-trajectory starts or ends
- `standing`: sub-trajectories of a stationary and of a moving rover
- `consistency`: test of the covariance (NEES)
- `three_sigma`: confidence of mean + 3 sigma
- `truth_error_rows`: error of the truth
- `aligned_error`: APE and RPE
- `plot_columns`: data of the plots

`map_score` makes the score of a cloud from the `point_errors` and the `coverage` of its pairs (`pair_truth`).
"""
