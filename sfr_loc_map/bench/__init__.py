"""Benchmarks: our methods beside reference methods on the same images, in the same run, each in its own process."""
