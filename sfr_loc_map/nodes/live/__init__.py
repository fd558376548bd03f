"""Feeds the live page from topics."""
