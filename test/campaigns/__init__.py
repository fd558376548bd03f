"""Long runs that are started by hand: `python -m campaigns NAME`."""
