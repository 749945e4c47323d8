"""Says how Sphinx builds the site, of pages that `make_site.py` has put together. `make docs`"""

from __future__ import annotations

import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import python_pages

project = "raygrid"
author = "the authors of raygrid"
copyright = author  # Sphinx's word; the licence is MIT
version = release = installed_version("raygrid")

extensions = ["myst_nb", "sphinx.ext.autodoc"]
root_doc = "index"
nb_execution_mode = "off"  # notebooks run in a test, tests/system/test_notebooks.py
myst_heading_anchors = 4  # pages link to headings as forges name them
highlight_language = "text"
smartquotes = False  # --stats is an option, not a dash
pygments_style = "friendly"
pygments_dark_style = "native"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = "raygrid"
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
html_static_path: list[str] = []


def setup(app: Any) -> None:
    """Called by Sphinx: lets docstrings in the form of this project become lists that HTML has."""
    python_pages.name_as_public()
    app.connect("autodoc-process-docstring", python_pages.process_docstring)
    app.connect("autodoc-process-signature", python_pages.process_signature)
