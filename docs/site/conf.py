"""Settings of the documentation site, which docs/make_site.py builds; any warning fails the build."""

import re

from pygments.lexers.special import TextLexer
from sphinx.application import Sphinx
from sphinx.domains.python import PyClasslike

from preshape import __version__

project = "preshape"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["README.md"]  # the front page includes it
myst_heading_anchors = 4
myst_enable_extensions = ["attrs_inline"]  # classes of pictures
templates_path = ["_templates"]

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "exclude-members": "__init__, __new__"}
ALIASES = {name: f"preshape.types.{name}" for name in ("Array", "IntArray", "BoolArray")}
autodoc_type_aliases = {**ALIASES, "ArrayLike": "ArrayLike"}
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False  # the signature has the types, with links
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 60
python_display_short_literal_types = True
highlight_language = "none"  # what is Python says so
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"preshape {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_show_search_summary = False  # a page opened as a file may not read the others


def readable(text: str | None) -> str | None:
    """A signature with short defaults, and the aliases in unions by name: Sphinx 9.0 writes them as calls."""
    if text is None:
        return None
    text = re.sub(r"TypeAliasForwardRef\('([\w.]+)'\)", r"\1", text)
    text = re.sub(r"= ([A-Z]\w+)\([^()]*\)", r"= \1()", text)
    return text.replace("<factory>", "...")


def setup(app: Sphinx) -> None:
    def signature(app, what, name, thing, options, arguments, answer):
        return readable(arguments), readable(answer)

    app.connect("autodoc-process-signature", signature)
    app.add_lexer("mermaid", TextLexer)  # code hosts draw these diagrams; the site shows their text
    for field in PyClasslike.doc_field_types:
        if field.name == "variable":
            field.label = "Attributes"
