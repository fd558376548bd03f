"""Pages, tables and exported files of suites."""
