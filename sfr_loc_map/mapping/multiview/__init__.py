"""From the clouds of several stereo pairs to one: poses are registered, points fused along their rays."""
