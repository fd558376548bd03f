"""Data sets that are folders or one file of stereo pairs, a module for each layout."""
