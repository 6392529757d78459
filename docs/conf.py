# SPDX-FileCopyrightText: Copyright (c) 2026 The newton-avbd Developers
# SPDX-License-Identifier: Apache-2.0
"""Configuration of the documentation site: Sphinx, MyST and the theme of Newton's own site.

    sphinx-build -W --keep-going docs docs/_build

builds it without a network. ``DOCS_ONLINE=1`` links Newton's, Warp's and NumPy's own sites, too.
"""

import importlib
import importlib.metadata
import os
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))  # plots.py

# Newton's site lists its classes under their public names, not under the modules that hold them.
for public in ("newton.solvers", "newton"):
    module = importlib.import_module(public)
    for name in module.__all__:  # some are imported when they are asked for
        if isinstance(member := getattr(module, name), type):
            member.__module__ = public

project = "newton-avbd"
author = "The newton-avbd Developers"
project_copyright = f"2026, {author}"
release = importlib.metadata.version("newton-avbd")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.intersphinx",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # MathJax as a part of the site: formulas need no network
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "plots",
]
exclude_patterns = ["_build"]

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 4

nitpicky = True
nitpick_ignore_regex = [
    ("py:.*", r"(newton|warp|wp|numpy|np|gymnasium|collections|typing)\..*"),
    ("py:.*", r"newton_avbd\.(rows|model)\..*"),  # what a user does not call
]

# A build without a network has nobody to ask for these.
_SITES = {
    "python": ("https://docs.python.org/3", None),
    "numpy": ("https://numpy.org/doc/stable", None),
    "warp": ("https://nvidia.github.io/warp", None),
    "newton": ("https://newton-physics.github.io/newton/latest", None),
}
intersphinx_mapping = _SITES if os.environ.get("DOCS_ONLINE") else {}

autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"

html_theme = "pydata_sphinx_theme"
html_title = f"newton-avbd {release}"
html_show_sourcelink = False
html_theme_options = {
    "navigation_depth": 2,
    "show_toc_level": 2,
    "show_prev_next": False,
    "use_edit_page_button": False,
}
