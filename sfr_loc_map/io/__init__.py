"""Recorded data: between files or messages of any format and the values of the suite, in both directions.

`tables`, `images`, `calibration` and `clouds` read and write one kind of file each, `bag` reads and writes messages.
`truth` determines which poses are the truth, `source_config` how a source is read, and `layouts` combines all of them
into a `Source` (`sequence`). `registry` opens a source, `convert` writes it in another format, and `message_stream`
yields its messages.

Invalid user input raises `InputError`, `OutputError` or `ConfigError` with a message of one line that names the file.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
