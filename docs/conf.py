"""The documentation: sphinx-build -W docs build/site.

Tutorials are executed, and what they print is shown.
"""

import re
import sys
from importlib.metadata import version as version_of
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.util.inspect import TypeAliasForwardRef

import pinograsp

# Sphinx shows arrays within unions and mappings as this.
TypeAliasForwardRef.__repr__ = lambda self: self.name

sys.path.insert(0, str(Path(__file__).parent))  # mathml, gallery_pictures

project, author = "pinograsp", "the pinograsp developers"
copyright = f"%Y, {author}"  # the year of the build
version = release = version_of("pinograsp")
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "myst_nb",
    "sphinx_design",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "mathml",
]
exclude_patterns = ["build", "notebooks", "templates"]
templates_path = ["templates"]
# Classes whose bases have more fields and methods: their pages link to these.
_named = [getattr(pinograsp, name) for name in pinograsp.__all__]
_classes = [one for one in _named if isinstance(one, type)]
_heirs = [one.__name__ for one in _classes if one.__bases__ != (object,)]
autosummary_context = {"heirs": _heirs}

# Every page with {code-cell} runs from start to end in a folder of its own; a cell that
# fails fails the build.
nb_execution_mode = "cache"
nb_execution_timeout = 600
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
myst_heading_anchors = 3
copybutton_exclude = ".linenos, .gp, .go"

# Every script of examples/gallery runs once, and again when it has changed; what it
# draws is shown beside it. -D plot_gallery=0 shows the scripts alone.
sphinx_gallery_conf = {
    "examples_dirs": "../examples/gallery",
    "subsection_order": [
        f"../examples/gallery/{section}"
        for section in ("hands", "wishes", "forces", "motion", "sensing", "films")
    ],
    "gallery_dirs": "gallery",
    "filename_pattern": "",
    "within_subsection_order": "FileNameSortKey",
    "nested_sections": False,
    "image_scrapers": "gallery_pictures.collect",
    "reset_modules": (),
    "capture_repr": (),
    "download_all_examples": False,
    "notebook_extensions": set(),
    "show_signature": False,
    "write_computation_times": False,
    "parallel": 2,
}

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
# Shapes are in the text.
_arrays = ("Array", "BoolArray", "IntArray", "ArrayLike")
autodoc_type_aliases = {name: name for name in _arrays}
python_maximum_signature_line_length = 80  # then one parameter per line
python_use_unqualified_type_names = True
napoleon_use_ivar = True
napoleon_use_param = True
napoleon_attr_annotations = False  # they are in the signature

html_theme = "furo"
html_title = "pinograsp"
# The theme's own underlines modules as if they were links.
pygments_dark_style = "monokai"
html_static_path = ["static"]
html_css_files = ["tables.css"]
html_theme_options = {"top_of_page_buttons": []}
html_search_scorer = str(Path(__file__).with_name("static") / "scorer.js")

# What people type into the search, and the pages that answer it: they come before pages
# that only mention it.
search_keywords = {
    "concepts/drives": ["torque", "motors", "servos"],
    "concepts/frames": ["frames", "units", "mm", "degrees", "quaternions", "pose"],
    "concepts/friction": ["friction", "friction cone", "soft fingers"],
    "howto/answers": ["status", "exit codes"],
    "howto/forces": ["torque limits", "contact forces"],
    "howto/hand_over": ["CSV", "gripper", "trajectory", "JointTrajectory"],
    "howto/hands": [
        "fingers",
        "torque limits",
        "URDF",
        "MJCF",
        "xacro",
        "mimic joints",
    ],
    "howto/objects": ["units", "mesh", "STL", "OBJ"],
    "howto/pick": ["IK", "inverse kinematics", "arm", "obstacles"],
    "howto/real_hands": ["torque limits", "registers", "data sheet", "logs"],
    "howto/reflex": ["slip", "taxels", "sensors"],
    "howto/troubleshooting": [
        "slip",
        "units",
        "mm",
        "frames",
        "infeasible",
        "problems",
    ],
    "howto/wishes": ["handle", "fingers", "approach"],
    "reference/motion": ["IK", "inverse kinematics"],
    "tutorials/gripper": ["gripper", "jaws"],
    "tutorials/own_hand": ["CSV", "URDF", "STL"],
}


_LONG = 20  # letters of a name that has its line to itself


def _plain_bars(app, what, name, obj, options, lines):
    """|x| is a norm in these docstrings, not a substitution."""
    for i, line in enumerate(lines):
        parts = line.split("``")
        parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
        lines[i] = "``".join(parts)


def _keep_sentences(app, what, name, obj, options, lines):
    """Before a colon in a property's first line napoleon would see its type."""
    if what in ("property", "attribute", "data") and lines:
        before, colon, after = lines[0].partition(": ")
        lines[:1] = [before + colon.rstrip(), after] if after else lines[:1]


def _part_attributes(app, what, name, obj, options, lines):
    """Attributes that share a text are fields of their own."""
    parted = []
    for line in lines:
        names, _, text = line.removeprefix(":ivar ").partition(":")
        shared = line.startswith(":ivar ") and "," in names
        each = names.split(", ") if shared else []
        parted += [f":ivar {one}:{text}" for one in each] or [line]
    lines[:] = parted


def _name_defaults(app, what, name, obj, options, signature, returned):
    """Defaults that are not Python, of factories and functions, as dots."""
    if signature is None:
        return None
    return re.sub(r"<factory>|<function .*?>", "...", signature), returned


def _skip_front_door(app, what, name, obj, skip, options):
    """Names at the front door have pages of their own: rooms do not repeat them."""
    return True if what == "module" and _is_at_front_door(name, obj) else None


def _skip_nameless_fields(app, what, name, obj, skip, options):
    """Fields of named tuples have their texts under Variables."""
    alias = str(getattr(obj, "__doc__", "")).startswith("Alias for field number")
    return True if alias or name == "model_config" else None


def _drop_model_signature(app, what, name, obj, options, signature, returned):
    """A case's sections with their validators are no signature that anybody reads."""
    return ("", None) if hasattr(obj, "model_fields") else None


def _is_at_front_door(name, obj):
    return name in pinograsp.__all__ and getattr(pinograsp, name) is obj


def _link_front_door(app, what, name, obj, options, lines):
    """A room's names at the front door, as links to their pages."""
    if what == "module":
        room = getattr(obj, "__all__", ())
        here = [one for one in room if _is_at_front_door(one, getattr(obj, one))]
        links = ", ".join(f":py:obj:`~{name}.{one}`" for one in here)
        if here:
            lines += ["", f"With pages of their own: {links}."]


def _break_names(app, doctree):
    """Long names in tables may break after their dots and lines."""
    for row in doctree.findall(nodes.row):
        for literal in row.findall(nodes.literal):
            name = literal.astext()
            pieces = re.split(r"(?<=[._/:])(?=\w)", name)
            if len(name) > _LONG and len(pieces) > 1:
                literal.clear()
                for piece in pieces:
                    gap = nodes.raw("", "<wbr>", format="html")
                    literal.extend([gap, nodes.Text(piece)])


def _add_keywords(app, doctree):
    """The page's keywords, as entries of the index: the search looks there first."""
    if words := app.config.search_keywords.get(app.env.docname):
        entries = [("single", word, "", "main", None) for word in words]
        doctree.insert(0, addnodes.index(entries=entries))


def setup(app):
    """What Sphinx calls first."""
    app.connect("autodoc-process-docstring", _keep_sentences, priority=400)
    app.connect("autodoc-process-docstring", _plain_bars)
    app.connect("autodoc-process-docstring", _part_attributes, priority=600)
    app.connect("autodoc-process-docstring", _link_front_door)
    app.connect("autodoc-skip-member", _skip_front_door)
    app.connect("autodoc-skip-member", _skip_nameless_fields)
    app.connect("autodoc-process-signature", _drop_model_signature)
    app.connect("autodoc-process-signature", _name_defaults)
    app.add_config_value("search_keywords", {}, "env", types=(dict,))
    app.connect("doctree-read", _break_names)
    app.connect("doctree-read", _add_keywords)
