"""The pages' templates: everything escaped, an unknown name is an error, no script and no outside resource."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from bcid import __version__


def write_page(path: Path, template: str, filters: Mapping[str, Callable[..., str]], **content: Any) -> None:
    """Render the jinja2 template with the file name `template` (in this package) into the HTML file `path`.

    The template can use the functions in `filters`, the names in `content` and bcid's `version`.
    """
    environment = Environment(
        loader=PackageLoader("bcid.report", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters |= filters
    text = environment.get_template(template).render(version=__version__, **content)
    path.write_text(text, encoding="utf-8")
