"""Commands that a benchmark of scores starts as scripts."""
