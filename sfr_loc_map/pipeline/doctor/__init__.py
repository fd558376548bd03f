"""Blocking issues of a bag or of a running graph: what is observed, checks by cause, findings with a fix."""
