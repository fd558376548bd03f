"""Statements about all errors from a sample of them: intervals of mean + 3 sigma, and tolerance bounds."""
