"""Readers and writers of all formats, and the configuration of how a source is read.

Invalid user input raises `InputError`, `OutputError` or `ConfigError` with a message of one line that names the file.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
