"""Runs of the parts over whole sources: replay, conversion, scoring."""
