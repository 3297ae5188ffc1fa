"""One take told with limits as they are, and with one of them halved or doubled: what is told, and whether it differs.

Simulation, estimate and base fit are made once for a take.  A limit of the search needs a new search, whose refits are
those of the search with limits as they are, as long as it goes the same way; one by which only the result of a search
is judged needs none.
"""

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from threadpoolctl import threadpool_limits

from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.judge.verdict import judge_names
from bcid.diagnosis.limits import DECIDING_LIMITS, JUDGE_LIMITS, limit_set_to
from bcid.diagnosis.search.name_search import Naming, name_effects
from bcid.likelihood.divergence import refuse_divergence
from bcid.likelihood.kept_fits import KeptFits, use_kept_fits
from bcid.likelihood.take import Take
from bcid.proof.blind.blind_case import BlindCase
from bcid.proof.blind.diagnose_case import estimate_concealed_drive
from bcid.virtual_lab import read_vehicle_text, record_drive

FACTORS = {"halved": 0.5, "doubled": 2.0}


class Variation(NamedTuple):
    """A limit "halved" or "doubled"; without a limit all are as they are."""

    limit: str = ""
    change: str = ""

    @property
    def value(self) -> float:
        """The limit's value with the change; a whole number stays one, of at least 1."""
        now: float = getattr(DECIDING_LIMITS[self.limit], self.limit)
        changed = now * FACTORS.get(self.change, 1.0)
        return max(1, round(changed)) if isinstance(now, int) else changed

    @property
    def needs_search(self) -> bool:
        """Whether names are sought with it, and not only judged."""
        return DECIDING_LIMITS[self.limit] is not JUDGE_LIMITS


AS_THEY_ARE = Variation()


def list_variations() -> list[Variation]:
    """All limits as they are; then each deciding one halved, and doubled."""
    return [AS_THEY_ARE, *(Variation(name, change) for name in DECIDING_LIMITS for change in FACTORS)]


def told_verdict(naming: Naming, take: Take) -> dict[str, Any]:
    """What a take is told, as JSON: "verdict", "names" and "channel".  Two verdicts are the same if all three are.

    "verdict" is its kind ("named", "ambiguous", "unknown", "nothing-found").  "names" are the ids of the effects that
    are named, in the alphabet's order; effects that cannot be told from them count only by making the kind "ambiguous".
    "channel" is the one in which something unknown acts, as blind tests count it: the first of what a remainder
    explains; empty where the kind is another than "unknown".  Values, gains and probabilities do not count.
    """
    with threadpool_limits(1, "blas"):
        judgement = judge_names(naming, take)
    channels = naming.rest.seen.channel_nats() if judgement.verdict == "unknown" else {}
    return {
        "verdict": judgement.verdict, "names": sorted(f.effect for f in judgement.findings),
        "channel": next(iter(channels), ""),
    }  # fmt: skip


class VariedTake:
    """A take with its base fit and names, of which verdicts are told with one limit or another changed."""

    def __init__(self, case: BlindCase) -> None:
        """Simulate, estimate, fit the base model and search for names, once for all that is told.

        Raises:
            InputRefused: too little of the take can be used, or no model can follow it.
        """
        files = case.lab_files
        vehicle = read_vehicle_text(files.vehicle)
        self.recording = record_drive(case.simulate(), case.rate_hz, vehicle, "concealed")
        estimate, reference = estimate_concealed_drive(self.recording, vehicle, files.vehicle, files.simulation)
        self.base = fit_base_model([self.recording], [estimate], vehicle, reference)
        self.left_out, self.kept = case.left_out, KeptFits()
        with refuse_divergence([self.recording]):
            self.given = self.base.evaluate_reference()
            self.naming = self.search()
        self.kept.is_open = False

    def search(self) -> Naming:
        """The names that a search gives with the limits as they are now."""
        with threadpool_limits(1, "blas"), use_kept_fits(self.kept):
            return name_effects(self.base.fit, self.base.take, self.left_out, self.base.others, self.given)

    def tell(self, variation: Variation) -> dict[str, Any]:
        """What the take is told (`told_verdict`) with a limit changed.

        Raises:
            InputRefused: predictions diverge.
        """
        if variation == AS_THEY_ARE:
            return told_verdict(self.naming, self.base.take)
        with refuse_divergence([self.recording]), limit_set_to(variation.limit, variation.value):
            return told_verdict(self.search() if variation.needs_search else self.naming, self.base.take)


def tell_variations(
    case: BlindCase, variations: Iterable[Variation], keep: Callable[[Variation, dict[str, Any]], None],
    in_time: Callable[[], bool],
) -> None:  # fmt: skip
    """Tell a case's verdict with each of the `variations` of limits, and hand each to `keep` as soon as it is there.

    An exception of any kind is handed over as a row with its text as "error"; one that the take ends in with all limits
    as they are, as theirs, and no other is told.  None begins once `in_time` is false.
    """
    try:
        take = VariedTake(case)
    except Exception as error:  # whatever it is, it is this take's and ends no other
        keep(AS_THEY_ARE, {"error": repr(error)})
        return
    for variation in variations:
        if not in_time():
            return
        try:
            row = take.tell(variation)
        except Exception as error:  # this limit's
            row = {"error": repr(error)}
        keep(variation, row)
