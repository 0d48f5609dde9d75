"""Sphinx configuration; `make docs` builds with warnings as errors."""

import importlib
import inspect
from importlib import metadata

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from keycld_control.cli.systems import rows

project = "KeyCLD"
author = "The KeyCLD developers"
copyright = author
release = metadata.version("keycld")

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"KeyCLD {release}"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # notebooks hold their outputs; tests run them
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True


class MarkdownDocstring(SphinxDirective):
    """`{markdown-docstring} package.Name`: a docstring written in Markdown, as Gymnasium's environments have."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Parse the docstring where the directive stands, its headings one level down."""
        module, _, name = self.arguments[0].rpartition(".")
        text = inspect.getdoc(getattr(importlib.import_module(module), name)) or ""
        lines = [f"#{line}" if line.startswith("#") else line for line in text.partition("\nRaises:")[0].splitlines()]
        container = nodes.section()
        self.state.nested_parse(StringList(lines, self.arguments[0]), 0, container, match_titles=True)
        return container.children


class Systems(SphinxDirective):
    """`{systems}`: the systems that come with the library, as `keycld systems` lists them."""

    def run(self) -> list[nodes.Node]:
        """A Markdown table of all of them."""
        lines = ["| environment | motors | gear | default range | control step |", "|---|---|---|---|---|"]
        for row in rows():
            motors, gears = ", ".join(row["motors"]), ", ".join(f"{gear:g}" for gear in row["gear"])
            low, high = row["range"]
            step = f"{row['control_step_s']:g} s"
            lines.append(f"| `{row['environment']}` | {motors} | {gears} | {low:g} to {high:g} | {step} |")
        container = nodes.section()
        self.state.nested_parse(StringList(lines, "systems"), 0, container)
        return container.children


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.add_directive("markdown-docstring", MarkdownDocstring)
    app.add_directive("systems", Systems)
