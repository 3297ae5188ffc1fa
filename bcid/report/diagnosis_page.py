"""The page of a diagnosis."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.model_card import ModelCard
from bcid.effects.table import ENTRIES
from bcid.report import formats
from bcid.report.before_after_figures import draw_before_after_pictures
from bcid.report.budget_words import budget_rows
from bcid.report.canvas import Columns
from bcid.report.disturbance import located_windows
from bcid.report.drive_words import describe_start
from bcid.report.everyday_words import size_in_words
from bcid.report.law_figures import draw_missing_laws
from bcid.report.limits import LIMITS
from bcid.report.so_what import finding_sentences, next_sentences, remainder_sentences
from bcid.report.templates import write_page
from bcid.report.verdict_words import CHANNELS, short_take_sentence, verdict_sentence
from bcid.report.where_figures import draw_where_pictures


def write_diagnosis_page(
    diagnosis: DiagnosisDocument, knots: Columns, tracks: Columns, path: Path, card: ModelCard | None = None
) -> None:
    """Write the HTML page of a diagnosis to `path`, with pictures of the disturbance and of predicted paths.

    `card` says where it comes from, if that is known.
    `knots` are columns (K,) of means over a knot of states and unexplained acceleration, before and after the
    effects found are added; `tracks` are columns of measured and predicted positions.
    """
    filters: dict[str, Callable[..., str]] = {
        "plain": formats.plain_name, "number": formats.format_number, "unit": formats.unit_text,
        "symbol": formats.symbol_text, "p": formats.format_p_value, "fixed": formats.format_rounded,
        "nmse": partial(formats.format_thousandths, missing="–"), "either": partial(formats.join_words, last="or"),
        "change": formats.format_change,
    }  # fmt: skip
    changes = "with the base model’s own simplifications adjusted" if diagnosis.corrections else ""
    if diagnosis.findings:
        changes = f"with {formats.join_words([formats.plain_name(f.effect) for f in diagnosis.findings])}"
    budget = diagnosis.error_budget
    so_what = {
        "findings": finding_sentences(diagnosis), "left": remainder_sentences(diagnosis),
        "next": next_sentences(diagnosis),
        "rows": budget_rows(budget) if budget else [],
    }  # fmt: skip
    write_page(
        path, "diagnosis.html.j2", filters, so_what=so_what, budget=budget, card=card, span_names=formats.SPAN_NAMES,
        in_words=size_in_words, sentence=verdict_sentence(diagnosis),
        short=short_take_sentence(diagnosis), d=diagnosis, after=changes,
        start=describe_start(diagnosis.next_manoeuvre) if diagnosis.next_manoeuvre else "",
        windows=located_windows(diagnosis), channels=CHANNELS, entries=ENTRIES, folded=LIMITS.folded_rows,
        channel_gains=[(c, n) for c, n in diagnosis.channels.items() if n > 0.0],
        with_error=formats.format_with_percent,
        where_pictures=[*draw_missing_laws(diagnosis), *draw_where_pictures(diagnosis, knots)],
        proof_pictures=draw_before_after_pictures(diagnosis, knots, tracks),
    )  # fmt: skip
