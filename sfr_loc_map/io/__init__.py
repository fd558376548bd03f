"""Readers and writers of data sets, bags, trajectories and clouds."""
