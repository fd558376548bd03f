"""The errors of the trajectory [4.1, 4.2.3] and of the cloud [4.3.4] as rows of the table of figures.

`trajectory_score` makes the score of the trajectory: `trajectory_errors` selects the sub-trajectories and makes their
rows. `other_frames` makes the rows of errors at frames at which no judged sub-trajectory starts or ends.
`standing` makes the rows of sub-trajectories of a stationary and of a moving rover. `consistency` makes the
rows of the covariance (NEES), and `three_sigma` makes the rows of the confidence. `plot_columns` makes the data of the
plots. `map_score` makes the score of a cloud from the `point_errors` and the `coverage` of its pairs (`pair_truth`).
"""
