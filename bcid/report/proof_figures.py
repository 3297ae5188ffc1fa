"""The pictures of a blind test: what was taken for what, and whether stated probabilities hold."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib as mpl
import numpy as np

from bcid.effects.table import EFFECTS
from bcid.report.figures import png

mpl.use("Agg")
import matplotlib.pyplot as plt  # the backend must be chosen first

OTHER_ANSWERS = ("unknown", "nothing", "error")


def confusion_picture(confusion: Mapping[str, Mapping[str, int]]) -> str:
    """What was concealed against what was answered first, as a PNG."""
    known = [e for e in EFFECTS if e in confusion]
    more = [e for e in confusion if e not in EFFECTS]
    truths = [*known, *more]
    answers = [*(e for e in EFFECTS if e in known or any(e in said for said in confusion.values())), *OTHER_ANSWERS]
    counts = np.array([[confusion[t].get(a, 0) for a in answers] for t in truths], dtype=float)
    counts = counts.reshape(len(truths), len(answers))
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    figure, ax = plt.subplots(figsize=(11, 1.5 + 0.2 * len(truths)), layout="constrained")
    ax.imshow(np.ma.masked_equal(shares, 0.0), cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    ax.set_xticks(range(len(answers)), [a.replace("_", " ") for a in answers], rotation=90, fontsize=7)
    ax.set_yticks(range(len(truths)), [t.replace("_", " ") for t in truths], fontsize=7)
    for i, j in zip(*np.nonzero(counts), strict=True):
        ax.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=6,
                color="white" if shares[i, j] > 0.5 else "black")  # fmt: skip
    ax.set_xlabel("answered first")
    ax.set_ylabel("concealed alone")
    ax.grid(False)
    return png(figure)


def calibration_picture(calibration: Mapping[str, Any]) -> str:
    """Stated probability against the share that was there, as a PNG."""
    figure, ax = plt.subplots(figsize=(4.5, 4.0), layout="constrained")
    ax.plot([0, 1], [0, 1], color="#999999", lw=1)
    bins = calibration["bins"]
    ax.plot([b["stated"] for b in bins], [b["there"] for b in bins], "o", color="#0072b2")
    for b in bins:
        if "there_ci95" in b:
            ax.plot([b["stated"]] * 2, b["there_ci95"], color="#0072b2", lw=1)
        ax.annotate(f"{b['n']:.0f}", (b["stated"], b["there"]), textcoords="offset points", xytext=(6, -10), fontsize=8)
    ax.set_xlabel("stated probability")
    ax.set_ylabel("share that was there")
    ax.set_xlim(0, 1.03)
    ax.set_ylim(0, 1.03)
    return png(figure)
