"""Statistics over the results of one suite, and the comparison of two suites."""
