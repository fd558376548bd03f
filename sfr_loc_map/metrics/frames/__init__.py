"""From poses to frames: pairs of an estimated and a true pose in common axes, and the error of the true pose.

`association` pairs the poses by their stamps, and `placement` makes the frames that a ground truth without attitudes,
heights or tilt permits. `aligned_error` fits an alignment (also for APE and RPE), and `truth_error` is the error of the
ground truth at the frames. `covariance` has the layout of the covariances of poses.
"""
