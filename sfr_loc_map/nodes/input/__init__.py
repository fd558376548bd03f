"""Inputs of the nodes: pairs from images, poses of pairs, odometry, extrinsics and true poses."""
