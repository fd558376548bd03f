"""Playback of a source: its messages in order, their pacing, the operator's controls."""
