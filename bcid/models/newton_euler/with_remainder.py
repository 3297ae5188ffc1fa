"""The Newton-Euler car with effects and with what has no name, where it was found, as a model like the others.

A diagnosis makes it where names leave something: it predicts better than the names alone where the car was driven, and
is that car where it was not.  Nothing else can be done with it: what has no name is no physics.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Self

from bcid.aliases import Floats
from bcid.effects.remainder_table import COEFFICIENT, INPUTS
from bcid.effects.table import effect_switches
from bcid.models.interface import Arrays, History, ScanKernels, build_scan_kernels
from bcid.models.newton_euler import remainder_step
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler, DiagnosedCar
from bcid.models.newton_euler.unnamed_part import UnnamedPart


@dataclass(frozen=True)
class NewtonEulerWithRemainder(DiagnosedCar):
    """The Newton-Euler car with effects, and functions without a name beside them."""

    named: AugmentedNewtonEuler
    unnamed: UnnamedPart = field(compare=False)
    motion: ClassVar[slice] = AugmentedNewtonEuler.motion
    kernels: ClassVar[ScanKernels] = build_scan_kernels(remainder_step.scan_with_remainder, parallel=False)
    name: ClassVar[str] = "newton-euler-remainder"
    lags: ClassVar[int] = AugmentedNewtonEuler.lags

    @property
    def period_s(self) -> float:  # type: ignore[override]
        """The time (s) that a step advances."""
        return self.named.period_s

    @property
    def facts(self) -> Mapping[str, Any]:
        """How the car and its effects were fitted."""
        return self.named.facts

    @property
    def parameter_count(self) -> int:
        """How many numbers the diagnosis fitted: the car's and its effects', and coefficients of functions."""
        return self.named.parameter_count + len(self.unnamed.functions)

    @cached_property
    def setup(self) -> remainder_step.RemainderSetup:
        """What the compiled step needs beside the carry."""
        switches = effect_switches(self.named.effects, self.unnamed.functions, self.unnamed.plan)
        whole = self.named.setup._replace(switches=switches)
        return remainder_step.RemainderSetup(self.named.setup, whole, self.unnamed.driven)

    def scale_functions(self, share: float) -> Self:
        """This car with its functions at a `share` of their size."""
        functions = self.unnamed.functions.copy()
        functions[:, COEFFICIENT] *= share
        return replace(self, unnamed=self.unnamed._replace(functions=functions))

    def with_period(self, period_s: float) -> Self:
        """This car advancing by `period_s` (s) a step."""
        return replace(self, named=self.named.with_period(period_s))

    def init(self, history: History) -> Floats:
        """The carry at the history's last row: that of the car with its effects."""
        return self.named.init(history)

    def describe(self) -> str:
        """The car's equations and effects with their constants, and where what has no name acts in full."""
        ranges = [
            f"  {low:8.3g} <= {name:10} <= {high:<8.3g}"
            for name, (low, high) in zip(INPUTS, self.unnamed.driven.tolist(), strict=False)
        ]
        count = f"beside them {len(self.unnamed.functions)} functions without a name, which fade outside of"
        return "\n".join([self.named.describe(), count, *ranges])

    def to_saved(self) -> tuple[dict[str, Any], Arrays]:
        """The JSON object and the arrays from which `from_saved` restores the model."""
        data, _ = self.named.to_saved()
        return data, self.unnamed._asdict()

    @classmethod
    def from_saved(cls, data: Mapping[str, Any], arrays: Arrays) -> Self:
        """The model that `to_saved` gave `data` and `arrays` of.

        Raises:
            ValueError: either is none of such a model.
        """
        return cls(AugmentedNewtonEuler.from_saved(data, {}), UnnamedPart.from_arrays(arrays))
