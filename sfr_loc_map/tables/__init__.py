"""Tables of any results: the model of a table, its formats, and tables of typed rows.

- `model`: numbers with units, and tables of cells, each with its text, exact value and key in the JSON
- `formats`: writes tables for the terminal and as HTML, Markdown and CSV
- `typed`: makes tables whose columns are functions of a row
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
