"""The reference, made by Sphinx from the docstrings: sphinx-build -W docs build/site."""

from importlib.metadata import version as version_of

project, author = "pinograsp", "the pinograsp developers"
version = release = version_of("pinograsp")
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "myst_parser"]
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # shapes and units are in the text
napoleon_use_ivar = True
html_theme = "furo"
html_title = "pinograsp"
exclude_patterns = ["build"]


def _plain_bars(app, what, name, obj, options, lines):
    """|x| is a norm in these docstrings, not a substitution."""
    for i, line in enumerate(lines):
        parts = line.split("``")
        parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
        lines[i] = "``".join(parts)


def setup(app):
    """What Sphinx calls first."""
    app.connect("autodoc-process-docstring", _plain_bars)
