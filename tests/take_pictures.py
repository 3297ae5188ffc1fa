"""The two pictures of the README, taken from the pages that `bcid run` has made of the sample logs.

`python tests/take_pictures.py WORKSPACE` opens the pages of the report and of the diagnosis in a Chromium, and writes
docs/results/report.png (headline and table of the models) and docs/results/another_day.png (map of what is missing).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from browsing import start_browser

RESULTS = Path(__file__).parents[1] / "docs" / "results"
WIDTH_PX = 1000
MAP = "figure:has(svg[aria-label*='floor'])"
HEADLINE = """() => {
  const table = document.querySelector('table').getBoundingClientRect();
  return {x: 0, y: 0, width: innerWidth, height: table.bottom + scrollY + 12};
}"""
"""The part of the page down to the end of its first table."""


def take_pictures(browser: Any, workspace: Path) -> None:
    """Write both pictures."""
    page = browser.new_page(viewport={"width": WIDTH_PX, "height": 800}, color_scheme="light")
    page.goto((workspace / "report" / "index.html").absolute().as_uri())
    page.screenshot(path=RESULTS / "report.png", full_page=True, clip=page.evaluate(HEADLINE))
    page.goto((workspace / "diagnosis" / "diagnosis.html").absolute().as_uri())
    page.locator(MAP).first.screenshot(path=RESULTS / "another_day.png")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    with start_browser() as browser:
        take_pictures(browser, Path(sys.argv[1]))
