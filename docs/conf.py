"""The documentation site: `make docs`, or rosdoc2."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent), str(HERE / "_ext")]

from sfr_loc_map import __version__  # noqa: E402

project = "sfr_loc_map"
author = "sfr_loc_map maintainers"
project_copyright = "sfr_loc_map maintainers, Apache-2.0"
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "mathml",
    "reference_pages",
]
exclude_patterns = ["_build", "_ext", "_figures"]
source_suffix = {".md": "markdown"}
highlight_language = "none"
smartquotes = False  # two dashes are an option

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
myst_dmath_allow_space = False
suppress_warnings = ["myst.header"]  # an included page begins with its own heading

html_theme = "furo"
html_title = f"sfr_loc_map {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_show_sourcelink = False
html_use_index = False  # docs/python.md is the index of names, and the search
copybutton_exclude = ".linenos, .gp, .go"

autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "separated"
autodoc_default_options = {"members": True, "show-inheritance": False}
python_maximum_signature_line_length = 100
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
