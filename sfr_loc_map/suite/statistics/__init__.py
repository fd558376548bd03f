"""Statistics over the results of a suite, of two suites, and of the suites of many nights."""
