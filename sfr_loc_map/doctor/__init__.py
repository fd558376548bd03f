"""Diagnosis of a recording or a running graph: the issues and their fixes."""
