"""Statistics over the results of one suite, of two suites, and of the suites of many nights."""
