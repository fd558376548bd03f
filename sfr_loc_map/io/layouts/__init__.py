"""Sources of stereo pairs: one module for each layout, including bags, and the parts that layouts share."""
