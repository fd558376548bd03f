"""The score of a cloud [4.3.4]: the truth of its pairs, the errors of its points, and its coverage.

`map_score.score_map` makes the rows of the table of figures from the errors of the points (`point_errors`) and from the
coverage of the true points (`coverage`). `pair_truth` is the ground truth of the mapping pairs.
"""
