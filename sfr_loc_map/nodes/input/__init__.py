"""Inputs of the nodes: pairs from images, poses, extrinsics, true poses, and the run that a stamp belongs to."""
