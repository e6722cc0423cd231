"""How Sphinx builds the site: ``make docs``."""

from capsyn.version import __version__

project = "capsyn"
copyright = "2026, the capsyn authors"
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3

default_role = "code"  # of single backticks in docstrings
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False

html_theme = "furo"
html_title = "capsyn"
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}
