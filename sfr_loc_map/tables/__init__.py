"""Tables of figures: one model, and its renderers for the terminal, HTML, Markdown and CSV."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
