"""Recorded data: conversion between files or messages of any format and the values of the suite, in both directions.

`number_text` parses numbers, and `stamps` has the rules for stamps. `tables`, `image_codec`, `calibration` and `clouds`
convert the content of files, and of messages with images, points or calibrations. `bag` reads and writes the messages
of bags, and reads their poses and frames. `source_format` detects the format of a source, `truth` determines which
poses are the truth, and `source_config` how a source is read. `layouts` combines all of them into a `Source`
(`sequence`), or writes a source as files. `registry` opens a source, `convert` writes it as a bag or as files, and
`message_stream` yields its messages.

Functions that take a path raise `InputError`, `OutputError` or `ConfigError` for invalid user input, with a message of
one line that names the file, and `MissingExtraError` if a package is missing. A parser without the name raises
`ValueError`, which `inputs.refusing` converts to a named `InputError`, or an `InputError` with its own advice, to which
`errors.naming` adds the name. Whether numbers are a pose is decided in `geometry.plausibility`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
