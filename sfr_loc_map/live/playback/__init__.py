"""Plays a recorded run to the live views: a bag, the folder of a replay, a data set."""
