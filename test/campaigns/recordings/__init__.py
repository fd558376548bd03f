"""Campaign from many kinds of recordings to a verdict."""
