"""Long runs that are started manually: `python -m campaigns NAME`."""
