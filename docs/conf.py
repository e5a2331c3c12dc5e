"""Settings of the documentation: make docs. Nothing is fetched while it is built or read.

The sources are those of the repository, not only of this folder, so that links between pages hold in both.
"""

from __future__ import annotations

import gc
import logging
import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

# Collecting what lives to the end of the build, and messages that nobody reads, take a tenth of its time.
gc.set_threshold(200_000, 50, 50)
logging.getLogger("sphinx").setLevel(logging.INFO)

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "transferlens"
author = "the transferlens authors"
copyright = "the transferlens authors, MIT licence"
version = release = installed_version("transferlens")

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_nb",
    "as_written",
    "command_reference",
    "cross_references",
    "equations",
    "readable",
]
root_doc = "docs/index"
include_patterns = [
    "docs/**.md",
    "notebooks/*.ipynb",
    "benchmarks/README.md",
    "designs/README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
]
exclude_patterns = [".*", "site", "build", "dist", "demo_output", "paper_output"]
nitpicky = True
smartquotes = False  # They would turn the dashes of options into one.
default_role = "code"

myst_enable_extensions = ["attrs_block", "deflist"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
nb_execution_mode = "off"  # The tests run them.

autodoc_default_options = {"members": True, "show-inheritance": True, "member-order": "bysource"}
autodoc_typehints = "none"  # as_written has them
autodoc_use_type_comments = False
add_module_names = False
maximum_signature_line_length = 80
toc_object_entries_show_parents = "hide"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "pydata_sphinx_theme"
html_title = f"transferlens {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_extra_path = ["root"]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_show_search_summary = False  # Pages that are opened as files may not read others.
html_sidebars = {"**": ["sidebar-nav-bs"], "docs/index": [], "docs/gallery": [], "docs/studio": []}
html_context = {"default_mode": "auto"}
html_theme_options: dict[str, Any] = {
    "logo": {"text": html_title},
    "header_links_before_dropdown": 8,
    "navbar_align": "left",
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
