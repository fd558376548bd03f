"""Readers and writers of all formats: they raise `InputError` and `OutputError`, with one line that names the file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
