"""The pages in a real browser: narrow and wide, light and dark, by keyboard and on paper."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import browsing
import numpy as np
import pytest
from browsing import contrast
from PIL import Image
from test_diagnosis_page import VERDICTS, Made, finding, law, named, write_diagnosis_page
from test_fleet_diagnosis import ALL_DAYS, DAYS, diagnosed_log, fleet_document
from test_in_short import card
from test_pipeline import Record

from bcid.documents.fleet import FleetDocument, FleetLog, LogProblem
from bcid.documents.prove import ProveDocument
from bcid.pipeline.config import read_pipeline_file
from bcid.pipeline.run import Pipeline
from bcid.report.fleet_page import write_fleet_page
from bcid.report.proof_page import write_proof_page

PROOF = Path(__file__).parents[1] / "docs" / "results" / "prove.json"
PLAN = """
vehicle = "{vehicle}"
training = ["{training}"]
validation = "{validation}"
truth = "{truth}"
models = ["newton-euler", "newton-euler-linear", "k-sindy"]
[report]
timing_repeats = 2
[report.published]
title = "What the makers publish"
nmse = {{ newton-euler = 0.0123 }}
"""
EFFECTS = {
    "rear_rolling_viscous": {"b": (12.0, 0.4, "kg s^-1")}, "steering_backlash": {"b": (0.03, 0.002, "rad")},
    "motor_delay": {"tau": (0.06, 0.004, "s")}, "tyre_relaxation": {"sigma": (0.2, 0.02, "m")},
    "body_yaw_misalignment": {"psi": (0.04, 0.003, "rad")},
}  # fmt: skip


def crowded() -> Made:
    """As many findings as an error is divided between, corrections, a rest without a name, and a drive to come."""
    document, knots, tracks = named()
    document["findings"] = [finding(effect, values, sentence="") for effect, values in EFFECTS.items()]
    document["corrections"] = [
        {"correction": "tyre_fall", "equation": "(1 − f) F̂", "parameters": {"f": {"value": 0.1, "se": 0.01}}},
    ]
    document["unknown"] = {"channel": "pose", "depends_on": ["yaw_rate"], "gain_nats": 97.0}
    document["next_manoeuvre"] = {
        "name": "slow figure of eight", "why": "It shows the yaw moment.", "file": "next_manoeuvre.commands.csv",
        "score": 41.0, "repeats": 2, "separates": ["motor_delay", "yaw_scrub"],
    }  # fmt: skip
    # of the other channels, those with the longest words beside the picture
    document["remainder"] = [
        {"channel": channel, "nats_before": 90.0, "nats_left": 0.4, "curve": law(0.06, quantity="steering_rate")}
        for channel in ("steering", "motor", "mz")
    ]
    return document, knots, tracks


def budget_of(document: dict[str, Any]) -> dict[str, Any]:
    """Parts of an error, as large as one another, of all kinds that a document of these findings can have."""
    causes = [("effect", [f["effect"]]) for f in document["findings"]]
    causes += [("corrections", [c["correction"] for c in document["corrections"]])] if document["corrections"] else []
    causes += [(cause, []) for cause in ("noise", "disturbances", "unexplained")]
    share = 1.0 / len(causes)
    parts = [{"cause": c, "effects": e, "share": share, "ci95": [share - 0.03, share + 0.03]} for c, e in causes]
    return {"horizon_s": 2.0, "nmse": document["fit"]["nmse_before"], "parts": parts}


def fleet() -> FleetDocument:
    """Logs of three days with an effect since the second, a motor gain that moves, a copy, and logs that failed."""
    rng = np.random.default_rng(4)
    logs = [diagnosed_log(i, 2.0 * (1.1 if DAYS[i] == 2 else 1.0) + 0.02 * rng.normal()) for i in range(len(DAYS))]
    document = fleet_document(logs, (*ALL_DAYS, "2026-12-01"))
    problem = LogProblem(stage="ingest", error="InputRefused", text="a/very/long/path/of/a/log.csv: file: is empty")
    lost = FleetLog(name="lost", file="lost.csv", state="failed", day=ALL_DAYS[0], problems=(problem,))
    copy = FleetLog(name="copy", file="copy.csv", state="done", day=ALL_DAYS[1], same_drive_as="log_5")
    return document.model_copy(update={"logs": (*document.logs, lost, copy), "problems": (problem,)})


DIAGNOSES = {**VERDICTS, "crowded": crowded}
KINDS = ("report", *DIAGNOSES, "proof", "fleet")
Open = Callable[..., Any]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with browsing.start_browser() as started:
        yield started


@pytest.fixture(scope="module")
def pages(
    browser: Any, tmp_path_factory: pytest.TempPathFactory, takes: dict[str, Path], vehicle_file: Path
) -> dict[str, Path]:
    """A page of each kind; the browser is asked for first, so that nothing is made where there is none."""
    folder = tmp_path_factory.mktemp("pages")
    plan = PLAN.format(
        vehicle=vehicle_file, training=takes["mcap"], validation=takes["other"], truth=takes["mcap"].parent / "truth"
    )
    (folder / "pipeline.toml").write_text(plan)
    work = Pipeline(read_pipeline_file(folder / "pipeline.toml"), Record())
    paths = {"report": work.publish(work.report(), "index.html", "report.json", to="report")}
    for kind, make in DIAGNOSES.items():
        document, knots, tracks = make()
        document["error_budget"] = budget_of(document)
        document["channels"] = {"fy": 285.0, "fx": 135.0, "steering": 21.4, "time": 4.3}
        paths[kind] = folder / f"{kind}.html"
        write_diagnosis_page(document, knots, tracks, paths[kind], card())
    paths["proof"] = folder / "proof.html"
    write_proof_page(ProveDocument.read(PROOF), paths["proof"])
    paths["fleet"] = folder / "fleet.html"
    write_fleet_page(fleet(), paths["fleet"])
    return paths


@pytest.fixture
def opened(browser: Any, pages: dict[str, Path]) -> Open:
    @contextmanager
    def open_page(kind: str, width: int = 1280, scheme: str = "light", media: str = "screen") -> Iterator[Any]:
        page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
        page.emulate_media(media=media, color_scheme=scheme)
        page.goto(pages[kind].as_uri())
        yield page
        page.close()

    return open_page


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_asks_for_nothing_and_reports_no_error(kind: str, browser: Any, pages: dict[str, Path]) -> None:
    page, asked, said = browser.new_page(), [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(pages[kind].as_uri())
    page.wait_for_load_state("networkidle")
    page.close()
    assert [url for url in asked if not url.startswith("data:")] == [pages[kind].as_uri()]
    assert said == []


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("kind", KINDS)
def test_a_page_fits_the_screen_and_can_be_read(kind: str, width: int, opened: Open) -> None:
    with opened(kind, width) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(browsing.SQUEEZED) == []
        assert page.evaluate(browsing.OVERLAPS) == []
        assert page.evaluate(browsing.OUTSIDE) == []
        words = page.evaluate(browsing.SIZES_OF_TEXT)
        assert words
        assert min(w["size"] for w in words) > 8.0


@pytest.mark.parametrize("kind", KINDS)
def test_a_page_has_the_structure_that_readers_of_screens_need(kind: str, opened: Open) -> None:
    with opened(kind) as page:
        found = page.evaluate(browsing.STRUCTURE)
    levels = found["levels"]
    assert found["lang"] == "en"
    assert found["title"]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in itertools.pairwise(levels))
    assert found["images"] >= 1
    assert (found["headless"], found["unscoped"], found["nameless"], found["doubled"]) == (0, 0, 0, 0)


def rgb(text: str) -> tuple[float, float, float]:
    red, green, blue = map(float, re.findall(r"[\d.]+", text)[:3])
    return red, green, blue


def palest(page: Any) -> list[str]:
    """Texts of less contrast to what is behind them than WCAG 2 AA asks: the commonest pixel there without the text."""
    words = page.evaluate(browsing.WORDS)
    page.add_style_tag(content="* { color: transparent !important; } svg text { fill: transparent !important; }")
    behind = Image.open(io.BytesIO(page.screenshot(full_page=True))).convert("RGB")
    pale = []
    for word in words:
        left, top, right, bottom = (round(v) for v in word["box"])
        part = behind.crop((left, top, max(right, left + 1), max(bottom, top + 1)))
        _, ground = max(part.getcolors(part.width * part.height))
        ratio = contrast(rgb(word["colour"]), ground)
        if ratio < (3.0 if word["large"] else 4.5):
            pale.append(f"{word['text']!r}: {word['colour']} on {ground}, {ratio:.1f}")
    assert len(words) > 40
    return pale


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("kind", KINDS)
def test_all_text_stands_out_from_what_is_behind_it(kind: str, scheme: str, opened: Open) -> None:
    with opened(kind, scheme=scheme) as page:
        ground = rgb(page.evaluate("getComputedStyle(document.body).backgroundColor"))
        assert (max(ground) < 64) == (scheme == "dark")
        assert palest(page) == []


def test_pale_text_is_noticed(opened: Open) -> None:
    with opened("named") as page:
        page.add_style_tag(content="h2 { color: #aaa }")
        assert any("'Where'" in text for text in palest(page))


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("kind", KINDS)
def test_all_that_opens_leads_or_scrolls_is_reached_by_keyboard(kind: str, width: int, opened: Open) -> None:
    with opened(kind, width) as page:
        wanted, reached = set(page.evaluate(browsing.REACHABLE)), set()
        for _ in range(len(wanted) + 40):
            page.keyboard.press("Tab")
            focus = page.evaluate(browsing.FOCUSED)
            if focus is None:
                break
            assert focus["outlined"]
            reached.add(focus["key"])
        assert wanted <= reached


def test_a_folded_table_opens_by_keyboard(opened: Open) -> None:
    with opened("unknown", 390) as page:
        summary = page.locator("summary").first
        summary.focus()
        page.keyboard.press("Enter")
        assert summary.evaluate("e => e.parentElement.open")


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_cut_on_paper(kind: str, opened: Open) -> None:
    """The width is that of A4 less its margins, of 13 mm; the proof's tables lie across."""
    width = round(((297 if kind == "proof" else 210) - 26) / 25.4 * 96)
    with opened(kind, width, scheme="dark", media="print") as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(browsing.CLIPPED) == []
        assert rgb(page.evaluate("getComputedStyle(document.querySelector('h1')).color")) < (64, 64, 64)
        folded = page.locator("details:not([open]) > :not(summary)")
        assert all(folded.nth(i).bounding_box() for i in range(folded.count()))


def printed(page: Any, **options: Any) -> list[Any]:
    """The sheets of a page as pdfium reads them; a PDF is printed as the stylesheet says, without backgrounds."""
    pdfium = pytest.importorskip("pypdfium2", reason="pypdfium2, of the extra dev, is not installed")
    return list(pdfium.PdfDocument(page.pdf(prefer_css_page_size=True, **options)))


def orphans(page: Any) -> list[str]:
    """Headings below which their sheet of paper is empty, though it is not the last."""
    headings = [h.strip() for h in page.locator("h1, h2, h3").all_inner_texts()]
    alone = []
    for sheet in printed(page)[:-1]:
        ink = sheet.render(scale=1.0).to_pil().convert("L").point(lambda v: 255 * (v < 160))
        text = sheet.get_textpage()
        for heading in headings:
            found = text.search(heading, match_case=True).get_next()
            if found is None:
                continue
            bottom = min(text.get_charbox(k)[1] for k in range(found[0], found[0] + found[1]))
            # below the descenders and the line under the heading
            below = ink.crop((0, round(sheet.get_height() - bottom) + 8, ink.width, ink.height))
            if below.getbbox() is None:
                alone.append(heading)
    return alone


@pytest.mark.parametrize("kind", KINDS)
def test_no_heading_ends_a_sheet(kind: str, opened: Open) -> None:
    with opened(kind, media="print") as page:
        assert orphans(page) == []


def test_a_heading_at_the_end_of_a_sheet_is_noticed(opened: Open) -> None:
    with opened("named", media="print") as page:
        page.add_style_tag(content="h2 { break-after: page !important; }")
        assert "Where" in orphans(page)


def test_bars_are_printed(opened: Open) -> None:
    """By a browser that leaves backgrounds out, as all do unless told otherwise."""
    blue = (0, 103, 163)

    def blue_pixels(page: Any) -> int:
        drawn = [sheet.render(scale=2.0).to_pil().convert("RGB") for sheet in printed(page, print_background=False)]
        return sum(n for image in drawn for n, colour in image.getcolors(image.width * image.height) if colour == blue)

    with opened("named", media="print") as page:
        page.evaluate("document.querySelectorAll('.panels, .shares, .swatch').forEach(e => e.remove())")
        page.add_style_tag(content=".verdict { border-color: black !important; }")
        assert blue_pixels(page) > 1000
        page.add_style_tag(content=".bars span { print-color-adjust: economy !important; }")
        assert blue_pixels(page) == 0


def test_every_part_of_the_error_is_seen_and_printed_in_its_own_colour(opened: Open) -> None:
    """On the screen, and by a browser that leaves backgrounds out."""
    with opened("crowded") as page:
        drawn = page.eval_on_selector_all(".shares span", "all => all.map(e => getComputedStyle(e).backgroundColor)")
        listed = page.eval_on_selector_all(".swatch", "all => all.map(e => getComputedStyle(e).backgroundColor)")
        assert drawn == listed
        assert len(set(drawn)) == len(drawn) == len(EFFECTS) + 4
        widths = page.eval_on_selector_all(".shares span", "all => all.map(e => e.getBoundingClientRect().width)")
        assert max(widths) - min(widths) < 1.0
        bar = page.locator(".shares").bounding_box()
        assert sum(widths) == pytest.approx(bar["width"], abs=1.0)
    with opened("crowded", media="print") as page:
        sheets = [sheet.render(scale=2.0).to_pil().convert("RGB") for sheet in printed(page, print_background=False)]
        colours = {colour for image in sheets for _, colour in image.getcolors(image.width * image.height)}
        assert {rgb(colour) for colour in drawn} <= colours


def test_a_page_says_in_short_what_it_comes_to_and_where_it_comes_from(opened: Open) -> None:
    for kind in (*DIAGNOSES, "report"):
        with opened(kind) as page:
            headings = page.locator("h2").all_inner_texts()
            assert headings[-1] in {"Model card", "Where this comes from"}
            assert (headings[0] == "In short") == (kind != "report")
            assert page.locator("h2:has-text('In short') ~ ul li").count() >= 2 or kind == "report"


def test_only_figures_that_the_pipeline_names_are_shown_as_published(opened: Open) -> None:
    with opened("report") as page:
        table = page.locator("h2:has-text('What the makers publish') + .scroll table")
        assert table.locator("td").all_inner_texts()[:2] == ["newton-euler", "12.30"]
        assert "paper's own" not in page.content()
