"""What is written of an adaptation: its values over time, what it is worth, and the filter in C with a test."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bcid.adaptation.adapt import Adaptation
from bcid.adaptation.c_source import write_adapt_header, write_adapt_source
from bcid.adaptation.c_test import write_adapt_test
from bcid.adaptation.formulas import LASTS_S
from bcid.adaptation.recovery import HORIZON_S, ErrorsOverTime
from bcid.aliases import Floats
from bcid.documents.adapt import AdaptDocument, AdaptedFigure, AdaptErrors, AdaptNoise
from bcid.estimate.types import Estimate
from bcid.export.formulas import COMMANDS

TABLE = "adapted.csv"
DOCUMENT = "adapt.json"


def write_adaptation(
    adaptation: Adaptation, errors: ErrorsOverTime, estimate: Estimate, name: str, model_digest: str, folder: Path,
    released: tuple[str, ...] = (),
) -> AdaptDocument:  # fmt: skip
    """Write adapted.csv, adapt.json and NAME_adapt.h, .c and _test.c into `folder`; returns what the JSON holds."""
    about = f"{name}: {adaptation.model.name} of the model {model_digest[:12]}"
    write_table(adaptation, estimate, folder / TABLE)
    sources = {
        f"{name}_adapt.h": write_adapt_header(name, about, adaptation.formulas, COMMANDS),
        f"{name}_adapt.c": write_adapt_source(name, about, adaptation.formulas, adaptation.filter, adaptation.noise),
        f"{name}_adapt_test.c": write_adapt_test(name, adaptation),
    }
    for file, text in sources.items():
        (folder / file).write_text(text, encoding="utf-8")
    document = _describe(adaptation, errors, estimate, model_digest, (TABLE, *sources), released)
    document.write(folder / DOCUMENT)
    return document


def write_table(adaptation: Adaptation, estimate: Estimate, path: Path) -> None:
    """Write the quantities and their standard deviations at the rows of the estimate as CSV."""
    names = [q.name for q in adaptation.quantities]
    columns = [estimate.time_s[:, None], adaptation.track.values, adaptation.track.sd]
    head = ",".join(["t_s", *names, *(f"{name}_sd" for name in names)])
    np.savetxt(path, np.hstack(columns), fmt="%.9g", delimiter=",", header=head, comments="")


def _describe(
    adaptation: Adaptation, errors: ErrorsOverTime, estimate: Estimate, digest: str, files: tuple[str, ...],
    released: tuple[str, ...],
) -> AdaptDocument:  # fmt: skip
    """What adapt.json holds."""
    values, sd, noise = adaptation.track.values[-1], adaptation.track.sd[-1], adaptation.noise
    figures = tuple(
        AdaptedFigure(
            name=q.name, constants=q.constants, is_factor=q.is_factor, unit=q.unit, first=q.said_start,
            first_sd=q.sd, last=float(values[i]), last_sd=float(sd[i]), low=q.low, high=q.high,
        )
        for i, q in enumerate(adaptation.quantities)
    )  # fmt: skip
    push, pose_sd = tuple(noise.q.tolist()), tuple(noise.pose_sd.tolist())
    return AdaptDocument(
        model=adaptation.model.name, model_digest=digest, recording=estimate.name, period_s=estimate.period_s,
        quantities=figures, released=released,
        noise=AdaptNoise(
            push=push, lasting_sd=noise.lasting_sd, lasts_s=LASTS_S, pose_sd=pose_sd, forget_s=noise.forget_s
        ),
        errors=AdaptErrors(
            horizon_s=HORIZON_S, predictions=len(errors.begin_s), frozen=_root_mean_square(errors.frozen),
            adapted=_root_mean_square(errors.adapted), loss_ci95=errors.loss_interval(),
        ),
        files=files,
    )  # fmt: skip


def _root_mean_square(errors: Floats) -> float | None:
    """The root mean square of some errors; None without any, or where one is infinite."""
    return float(np.sqrt(np.mean(errors**2))) if len(errors) and np.isfinite(errors).all() else None
