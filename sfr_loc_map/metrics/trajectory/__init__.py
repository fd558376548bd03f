"""Errors of sub-trajectories: association, re-basing, statistics, intervals, consistency of the covariance."""
