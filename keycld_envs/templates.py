"""HTML pages from templates."""

import jinja2


def templates(package: str) -> jinja2.Environment:
    """The templates in the folder `templates` of a package.

    Whatever a template shows is escaped, unless it is `markupsafe.Markup`. A name that a template was not given is an
    error.

    Args:
        package: dotted name.
    """
    return jinja2.Environment(
        loader=jinja2.PackageLoader(package),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
