"""Settings of Sphinx for the site; `build.py` collects the pages."""

import os
import sys
from pathlib import Path

import scancell

sys.path.insert(0, str(Path(__file__).parent))

project = "scancell"
author = "the scancell authors"
release = version = scancell.__version__
project_copyright = author

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "mathml", "signatures"]
exclude_patterns = ["docs/README.md"]

# Markdown as a code host shows it.
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
# Pages that a command writes may skip a level of headings; several classes have attributes of one name.
suppress_warnings = ["myst.header", "ref.python"]

# Pages with cells of code are notebooks: they are executed, and shown with their outputs.
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_merge_streams = True
nb_execution_raise_on_error = True
nb_execution_timeout = 900  # s; a busy machine takes long
nb_execution_excludepatterns = [] if os.environ.get("SCANCELL_RECORDINGS") else ["docs/notebooks/real_recordings.md"]

html_math_renderer = "mathml"
html_theme = "furo"
html_title = f"scancell {version}"
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_search_scorer = str(Path(__file__).with_name("scorer.js"))
html_show_search_summary = False  # pages of a folder cannot read other files
html_static_path = ["static"]
html_css_files = ["site.css"]

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_class_signature = "mixed"
napoleon_use_rtype = False
napoleon_use_ivar = True
napoleon_attr_annotations = False
