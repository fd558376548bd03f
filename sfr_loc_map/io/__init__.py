"""Readers and writers of all formats, and how a configuration says that a source is read.

Invalid user input raises `InputError`, `OutputError` or `ConfigError` with one line; readers add the name of the file.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
