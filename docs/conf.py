"""Sphinx configuration; `make docs` builds with warnings as errors."""

from importlib import metadata

project = "KeyCLD"
author = "The KeyCLD developers"
copyright = author
release = metadata.version("keycld")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["_build", "conftest.py"]
html_theme = "furo"
html_title = f"KeyCLD {release}"

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
