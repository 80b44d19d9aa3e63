"""Settings of the API pages; ``make docs`` builds them, and any warning fails the build."""

import re

from sphinx.application import Sphinx
from sphinx.domains.python import PyClasslike

from preshape import __version__

project = "preshape"
version = release = __version__

extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["_templates"]
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
html_css_files = ["api.css"]
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
    for field in PyClasslike.doc_field_types:
        if field.name == "variable":
            field.label = "Attributes"
