"""What functions without a name explain beside base models, by how pushes are taken to vary.

`python tests/measure_pushes.py [RECORDINGS]` fits the base model of three simulated small cars that lack nothing, and,
where RECORDINGS are given, of two real drives: with pushes that are constant over half a second and independent, over a
quarter of a second and independent, and over a quarter of a second and lasting, as the likelihood has them.  It writes
docs/results/pushes.json.  Each law of pushes is measured in a process of its own, as kernels are compiled for it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results" / "pushes.json"
SEED, CASES = 2330449787, (1183, 1199, 1207)
DRIVES = ("2024_10_01_01", "2024_09_50_18")


class PushLaw(NamedTuple):
    """How pushes vary."""

    knots: int  # in a segment of 1.5 s
    lasting: bool  # each correlated with the next


LAWS = PushLaw(3, False), PushLaw(6, False), PushLaw(6, True)


def measure(law: PushLaw, recordings: Path | None) -> dict[str, Any]:
    """Figures of each car and drive with pushes of this `law`, which is set before any kernel is compiled."""
    from bcid.likelihood import take

    take.KNOTS, take.KNOT_S, take.N_NUISANCE = law.knots, take.SEGMENT_S / law.knots, take.N_START + 3 * law.knots
    from bcid.likelihood import limits

    if not law.lasting:
        limits.LIKELIHOOD_LIMITS = replace(limits.LIKELIHOOD_LIMITS, most_lasting=0.0)
    from concealed import nothing_missing

    figures = {f"small-null-{number}": describe(nothing_missing(SEED, number)) for number in CASES}
    for name, base in real_drives(recordings) if recordings else ():
        figures[name] = describe(base)
    return figures


def real_drives(recordings: Path) -> Any:
    """The name and the base fit of each real drive, without a simulation."""
    from bcid.diagnosis.diagnose import fit_base_model
    from bcid.proof.real.jobs import QuestionInputs, read_questions

    questions = read_questions(ROOT / "pipelines" / "dart" / "cases.toml")
    inputs = QuestionInputs.of_questions(questions, recordings)
    for name in inputs.drives:
        if any(part in name for part in DRIVES):
            vehicle = inputs.vehicle_for(name)
            recording, estimate, _ = inputs.estimate_recording(name, vehicle)
            yield Path(name).stem, fit_base_model([recording], [estimate], vehicle)


def describe(base: Any) -> dict[str, Any]:
    """Nats of a base fit, of what the true parameters lack of it, and of what functions explain beside it."""
    from bcid.diagnosis.remainder.chance import draw_chance
    from bcid.diagnosis.remainder.explain import basis_for, explain

    fit, take, given = base.fit, base.take, base.evaluate_reference()
    basis = basis_for(fit, take)
    chance = draw_chance(fit, take, basis)
    return {
        "segments": take.segments, "log_likelihood": round(fit.log_likelihood, 1),
        "true_behind": round(fit.log_likelihood - given.log_likelihood, 1) if given else None,
        "explained": round(explain(fit, take, basis).nats, 1), "by_chance": round(chance.mean, 1),
        "by_chance_sd": round(chance.sd, 1), "rho": [round(float(rho), 3) for rho in fit.scales.rho],
    }  # fmt: skip


def main(arguments: list[str]) -> None:
    """Measure one law, whose index stands first, and print it; or all, each in a process of its own, and write them."""
    if len(arguments) == 2:
        recordings = Path(arguments[1]) if arguments[1] else None
        sys.stdout.write(json.dumps(measure(LAWS[int(arguments[0])], recordings)))
        return
    told = []
    for index, law in enumerate(LAWS):
        with tempfile.TemporaryDirectory() as cache:
            command = [sys.executable, __file__, str(index), arguments[0] if arguments else ""]
            done = subprocess.run(
                command, env=os.environ | {"NUMBA_CACHE_DIR": cache}, check=True, stdout=subprocess.PIPE, text=True
            )
        told.append({**law._asdict(), "takes": json.loads(done.stdout)})
        RESULTS.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
