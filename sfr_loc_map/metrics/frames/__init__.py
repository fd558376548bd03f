"""From poses to frames: pairs of an estimated and a true pose in common axes.

`association` pairs the poses by their stamps, and `placement` makes the frames that a ground truth without attitudes,
heights or tilt permits, with the `true_attitudes` that are known. `umeyama` fits an alignment, and `motion` states
when the rover moves. `covariance` has the layout of the covariances of poses. No module makes rows.
"""
