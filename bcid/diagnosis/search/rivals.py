"""What explains a take nearly as well: the accepted effects with one of them left out, or exchanged for another."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

from bcid.diagnosis.search.line_search import from_their_sizes
from bcid.diagnosis.search.place_search import placed
from bcid.diagnosis.search.refits import CLOSE, WORTH, best_first, fully, named, quickly, refit_with, told
from bcid.diagnosis.search.screen import screen
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import Changes
from bcid.likelihood.take import Take

EXCHANGES = 3  # rounds in which an exchange may win
OF_EACH = 3  # of the most promising others that each effect is exchanged for


class Beside(NamedTuple):
    """A fit and what stands beside it."""

    best: Fit
    without: dict[str, Fit]  # with each of its named effects left out
    others: tuple[Fit, ...]  # each with one named effect exchanged, best first


def settled(fit: Fit, take: Take, trials: Changes, known: Iterable[Fit], promising: Sequence[str] = ()) -> Beside:
    """The fit and its rivals, after exchanges of single effects for better ones as long as there are any.

    `known` are fits with fewer effects that need no refit, `promising` effects that are tried from their sizes too.
    """
    known = tuple(known)
    others: tuple[Fit, ...] = ()
    for _ in range(EXCHANGES):
        without = each_left_out(fit, known, take)
        others = distinct(fit, [*_exchanged(fit, take, trials, without, promising), *others])
        if not others or others[0].bic <= fit.bic:
            return Beside(fit, without, others)
        fit, others = placed(others[0], take), (fit, *others[1:])
    return Beside(fit, each_left_out(fit, known, take), distinct(fit, others))


def distinct(best: Fit, fits: Iterable[Fit]) -> tuple[Fit, ...]:
    """Of fits that hold the same effects the best one, best first; none that holds those of `best`, or differs more.

    A rival has one named effect in place of another.
    """
    mine, found = set(best.hypothesis.effects), dict[frozenset[str], Fit]()
    for f in sorted(fits, key=lambda f: f.bic):
        theirs = frozenset(f.hypothesis.effects)
        if len(mine - theirs) == 1 and len(theirs - mine) == 1:
            found[theirs] = f
    return tuple(sorted(found.values(), key=lambda f: -f.bic))


def each_left_out(fit: Fit, known: Iterable[Fit], take: Take) -> dict[str, Fit]:
    """The joint refit without each of the named effects, where it is not known already."""
    fits = {f.hypothesis.effects: f for f in known}
    found = {}
    for name in named(fit):
        rest = tuple(n for n in fit.hypothesis.effects if n != name)
        found[name] = fits[rest] if rest in fits else refit_with(fit, take, rest)
    return found


def _exchanged(fit: Fit, take: Take, trials: Changes, without: dict[str, Fit], promising: Sequence[str]) -> list[Fit]:
    """Refits with one of several effects exchanged for the most promising others, best first."""
    held, found = fit.hypothesis.effects, list[Fit]()
    for less in without.values():
        lost = fit.bic - less.bic
        for candidate in told(less, take, screen(less, take, trials.without(held)))[:OF_EACH]:
            if candidate.score > max(WORTH, CLOSE * lost):
                with suppress(FloatingPointError):
                    quick = quickly(less, take, candidate)
                    found.append(fully(quick, take) if fit.bic - quick.bic < CLOSE * lost else quick)
        found += from_their_sizes(less, take, [n for n in promising if n not in held], lost)[0]
    return best_first(found, take)
