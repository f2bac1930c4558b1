"""The documentation: sphinx-build -W docs build/site. Tutorials are executed, and what they print is shown."""

from importlib.metadata import version as version_of

project, author = "pinograsp", "the pinograsp developers"
version = release = version_of("pinograsp")
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx.ext.mathjax",
    "myst_nb",
    "sphinx_design",
    "sphinx_copybutton",
]
exclude_patterns = ["build", "notebooks"]

# Every page with {code-cell} runs from start to end in a folder of its own; a cell that fails fails the build.
nb_execution_mode = "cache"
nb_execution_timeout = 600
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 3
copybutton_exclude = ".linenos, .gp, .go"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
# Shapes are in the text.
autodoc_type_aliases = {name: name for name in ("Array", "BoolArray", "IntArray", "ArrayLike")}
python_maximum_signature_line_length = 80  # then one parameter per line
python_use_unqualified_type_names = True
napoleon_use_ivar = True
napoleon_use_param = True
napoleon_attr_annotations = False  # they are in the signature

html_theme = "furo"
html_title = "pinograsp"
html_static_path = ["static"]
html_css_files = ["tables.css"]
html_theme_options = {"top_of_page_buttons": []}


def _plain_bars(app, what, name, obj, options, lines):
    """|x| is a norm in these docstrings, not a substitution."""
    for i, line in enumerate(lines):
        parts = line.split("``")
        parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
        lines[i] = "``".join(parts)


def setup(app):
    """What Sphinx calls first."""
    app.connect("autodoc-process-docstring", _plain_bars)
