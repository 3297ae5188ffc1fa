"""A real browser for the pages' tests, and what is asked of a page there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")

SIZES_OF_TEXT = """() => [...document.querySelectorAll('svg text')].filter(t => t.textContent.trim()).map(t => {
  const scale = Math.hypot(t.getScreenCTM().a, t.getScreenCTM().b);
  return {text: t.textContent, size: parseFloat(getComputedStyle(t).fontSize) * scale};
})"""
"""Words in pictures with the height in pixels at which they are shown."""

OVERLAPS = """() => [...document.querySelectorAll('svg')].flatMap(svg => {
  const words = [...svg.querySelectorAll('text')].filter(t => t.textContent.trim());
  const boxes = words.map(t => t.getBoundingClientRect());
  const found = [];
  for (let i = 0; i < words.length; i++) for (let j = 0; j < i; j++) {
    const wide = Math.min(boxes[i].right, boxes[j].right) - Math.max(boxes[i].left, boxes[j].left);
    const high = Math.min(boxes[i].bottom, boxes[j].bottom) - Math.max(boxes[i].top, boxes[j].top);
    // boxes are as high as a line, with room above and below the letters
    if (wide > 1 && high > 0.4 * Math.min(boxes[i].height, boxes[j].height))
      found.push(`${svg.getAttribute('aria-label')}: ${words[i].textContent} | ${words[j].textContent}`);
  }
  return found;
})"""
"""Pairs of words in one picture that lie upon each other."""

OUTSIDE = """() => [...document.querySelectorAll('svg')].flatMap(svg => {
  const frame = svg.getBoundingClientRect();
  return [...svg.querySelectorAll('text')].filter(t => {
    const box = t.getBoundingClientRect();
    return box.left < frame.left - 2 || box.right > frame.right + 2 || box.bottom > frame.bottom + 2;
  }).map(t => `${svg.getAttribute('aria-label')}: ${t.textContent}`);
})"""
"""Words that a picture cuts off."""

SQUEEZED = """() => [...document.querySelectorAll('td, th, dd, dt')].filter(
  cell => cell.textContent.trim().length > 12 && cell.getClientRects().length && cell.getBoundingClientRect().width < 48
).map(cell => cell.textContent.trim())"""
"""Cells with more than a word in a column a few letters wide."""

CLIPPED = """() => [...document.querySelectorAll('main *')].filter(e => e.scrollWidth > e.clientWidth + 2
  && e.clientWidth > 0 && getComputedStyle(e).overflowX !== 'visible'
).map(e => e.tagName + ' ' + e.textContent.slice(0, 60))"""
"""Elements that hide or scroll a part of what they hold."""

STRUCTURE = """() => ({
  lang: document.documentElement.lang, title: document.title,
  levels: [...document.querySelectorAll('h1, h2, h3, h4, h5, h6')].map(h => Number(h.tagName[1])),
  headless: [...document.querySelectorAll('table')].filter(t => !t.querySelector('th')).length,
  unscoped: [...document.querySelectorAll('th')].filter(h => !['col', 'row'].includes(h.scope)).length,
  images: document.querySelectorAll('svg, img').length,
  nameless: [...document.querySelectorAll('svg, img')].filter(
    i => i.tagName === 'IMG' ? !i.alt : i.getAttribute('role') !== 'img' || !i.getAttribute('aria-label')).length,
  doubled: (ids => ids.length - new Set(ids).size)([...document.querySelectorAll('[id]')].map(e => e.id)),
})"""

WORDS = """() => {
  document.querySelectorAll('details').forEach(d => { d.open = true; });
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), found = [];
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    if (!node.textContent.trim()) continue;
    const range = document.createRange(), style = getComputedStyle(node.parentElement);
    range.selectNodeContents(node);
    const box = range.getClientRects()[0], frame = node.parentElement.closest('.scroll, pre, .broad');
    const edge = frame ? frame.getBoundingClientRect().right : innerWidth;
    if (!box || box.width < 2 || box.right > edge || style.visibility === 'hidden') continue;
    const drawn = node.parentElement.closest('svg') && style.fill !== 'currentcolor';
    const size = parseFloat(style.fontSize);
    found.push({
      text: node.textContent.trim(), colour: drawn ? style.fill : style.color,
      large: size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700),
      box: [box.left + scrollX, box.top + scrollY, box.right + scrollX, box.bottom + scrollY],
    });
  }
  return found;
}"""
"""Every run of text: its colour, whether it counts as large, and where it stands on the page (pixels)."""

FOCUSED = """() => {
  const e = document.activeElement;
  if (!e || e === document.body || e === document.documentElement) return null;
  const s = getComputedStyle(e);
  const outlined = s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) > 0;
  return {key: [...document.querySelectorAll('*')].indexOf(e), outlined};
}"""

REACHABLE = """() => {
  const all = [...document.querySelectorAll('*')];
  const shown = e => e.checkVisibility({contentVisibilityAuto: true});
  const scrolls = e => e.scrollWidth > e.clientWidth + 1 && ['auto', 'scroll'].includes(getComputedStyle(e).overflowX);
  const wanted = e => shown(e) && (e.matches('a[href], summary') || scrolls(e));
  return all.map((e, i) => [e, i]).filter(([e]) => wanted(e)).map(([, i]) => i);
}"""


def browser_path() -> str | None:
    """Path of a Chromium: BCID_BROWSER, one on the search path, or the one that playwright installed; None without."""
    named = os.environ.get("BCID_BROWSER")
    found = named or next(filter(None, map(shutil.which, NAMES)), None)
    if found:
        return found
    from playwright.sync_api import sync_playwright

    with sync_playwright() as p:
        own = p.chromium.executable_path
    return own if Path(own).exists() else None


@contextmanager
def start_browser() -> Iterator[Any]:
    """A headless browser; the tests are skipped where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright, of the extra dev, is not installed")
    path = browser_path()
    if path is None:
        pytest.skip("no Chromium is found: install one, or `playwright install chromium`, or set BCID_BROWSER")
    with api.sync_playwright() as p:
        # no sandbox: tests run as root in containers, and the pages are our own
        browser = p.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


def luminance(colour: tuple[float, float, float]) -> float:
    """Relative luminance of an sRGB colour (0 to 255), as WCAG 2 defines it."""
    linear = [c / 3294.6 if c <= 10.0 else ((c / 255.0 + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: tuple[float, float, float], other: tuple[float, float, float]) -> float:
    """Contrast ratio of two sRGB colours, 1 to 21, as WCAG 2 defines it."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)
