"""Sphinx's settings: the course as a website that needs nothing from any other host."""

from importlib.util import find_spec
from pathlib import Path

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.nodes import make_refnode

import omnistereo_learn
import omnistereo_lib as osl
import omnistereo_rigs

BOOK = Path(__file__).parent

project = "omnistereo"
language = "en"
extensions = [
    "myst_nb",
    "sphinx.ext.mathjax",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]

# Pages: notebooks with their stored outputs, so that no kernel is needed and nothing differs from
# what was checked.
nb_execution_mode = "off"
nb_render_markdown_format = "myst"  # captions may have links and formulas
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3

# One script that draws formulas as SVG. It asks for no fonts, which browsers refuse to pages opened
# from a folder, and the menu that would fetch more from elsewhere is off.
_MATHJAX = Path(
    find_spec("sphinx-mathjax-offline").submodule_search_locations[0], "static/mathjax/tex-svg.js"
)
mathjax_path = _MATHJAX.name
mathjax3_config = {"options": {"enableMenu": False}}

# Reference: the docstrings as they are. They say types and shapes in words, so signatures show
# names and defaults.
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_param = False
napoleon_use_rtype = False
default_role = "code"
viewcode_follow_imported_members = False

html_theme = "furo"
html_title = "omnistereo"
html_static_path = [
    str(_MATHJAX),
    *(str(BOOK / name) for name in ("book.css", "book.js", "stills.js")),
]
html_css_files = ["book.css"]
html_js_files = ["book.js", "stills.js"]
html_copy_source = False
html_domain_indices = False
html_show_copyright = False


def setup(app: Sphinx) -> None:
    """Register what the docstrings and the prose need beyond Sphinx's own ways."""
    app.connect("autodoc-process-docstring", keep_bars, priority=400)  # before napoleon
    app.connect("doctree-read", link_exact_types)
    app.connect("doctree-resolved", link_names)
    app.connect("html-page-context", name_for_readers, priority=900)  # after the theme


def keep_bars(
    app: Sphinx, what: str, name: str, value: object, options: object, lines: list[str]
) -> None:
    """Keep |r| an absolute value; reStructuredText would look for a substitution of that name."""
    lines[:] = [line.replace("|", r"\|") if "`" not in line else line for line in lines]


def link_exact_types(app: Sphinx, doctree: nodes.document) -> None:
    """Link types only by their full names: "columns" in the prose of a type is no attribute."""
    for reference in doctree.findall(addnodes.pending_xref):
        reference.attributes.pop("refspecific", None)


def link_names(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    """Link the library's names in running text, such as `SphereGrid.rays` or `osl.sgm`."""
    objects = app.env.domains.python_domain.objects
    for literal in list(doctree.findall(nodes.literal)):
        name = full_name(literal.astext())
        # a class's fields have no entry
        entry = objects.get(name) or objects.get(name.rpartition(".")[0])
        ours = entry is not None and (entry.objtype != "module" or name in literal.astext())
        if ours and entry.docname != docname and not is_linked(literal):
            link = make_refnode(
                app.builder, docname, entry.docname, entry.node_id, literal.deepcopy()
            )
            literal.replace_self(link)


def is_linked(node: nodes.Node) -> bool:
    """Tell whether a node is part of a link."""
    return node.parent is not None and (
        isinstance(node.parent, nodes.reference) or is_linked(node.parent)
    )


def name_for_readers(
    app: Sphinx, page: str, template: str, context: dict, doctree: nodes.document | None
) -> None:
    """Give captions of the navigation, which Sphinx calls headings, the level they need, and folded
    cells, which MyST-NB names otherwise, the name that is shown.
    """
    tree = context["furo_navigation_tree"]
    context["furo_navigation_tree"] = tree.replace(
        'role="heading"', 'role="heading" aria-level="2"'
    )
    if doctree:
        context["body"] = context["body"].replace(' aria-label="Toggle hidden content"', "")


def full_name(code: str) -> str:
    """Return the full name of code such as `osl.sgm(volume)`, `load_rig`, `metrics.error_map`."""
    name = code.partition("(")[0].removeprefix("osl.").removeprefix("omnistereo_lib.")
    for package in (omnistereo_rigs, omnistereo_learn):
        name = name.removeprefix(f"{package.__name__}.")
    first = name.partition(".")[0]
    for package in (osl, omnistereo_rigs, omnistereo_learn):
        if first in package.__all__:
            home = getattr(getattr(package, first), "__module__", package.__name__)
            return f"{home}.{name}"
    return f"omnistereo_lib.{name}"
