"""The constants of a saved Newton-Euler car, and what is stated of them, within bounds that make sense."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from bcid.models.saved_parts import (
    NotNegative,
    Period,
    Positive,
    SavedFacts,
    SavedPart,
    Share,
    Signed,
    Switch,
    Undetermined,
)  # fmt: skip
from bcid.physics.car import Car


class SavedCar(SavedPart):
    """All constants of a `Car`: those that are divided by are above zero, forces and stiffnesses not below."""

    m: Positive
    I_z: Positive
    l_f: Positive
    l_r: Positive
    T_s: Positive
    d: Positive
    F_m_max: NotNegative
    K_t: NotNegative
    K_b: NotNegative
    C_f: NotNegative
    C_r: NotNegative
    F_f_max: NotNegative
    F_r_max: NotNegative
    R_1: Signed
    R_2: Signed
    v_0: Positive
    front_share: Share = 1.0
    sets_force: Switch = 0.0
    u_0: Signed = 0.0
    K_v: NotNegative = 0.0
    reverses: Switch = 0.0
    follows_wheel: Switch = 0.0

    def to_car(self) -> Car:
        """The car with these constants."""
        return Car(**self.model_dump())


class FittedConstantFacts(SavedFacts):
    """What is stated of one fitted constant."""

    unit: str
    meaning: str
    relative_se: Annotated[float, Field(ge=0.0)] | None  # null where the takes do not identify it


class FitFacts(SavedFacts):
    """What is stated of the fit of a car."""

    fitted: dict[str, FittedConstantFacts] = Field(default_factory=dict)
    correlated: tuple[tuple[str, str, float], ...] = ()
    at_bound: tuple[str, ...] = ()
    top_speed_mps: Signed = 0.0
    mass_given: bool = True
    optimiser: str = ""
    fit_quality: str = ""

    @model_validator(mode="after")
    def _check_symbols(self) -> Self:
        """Refuse what no car has among the fitted constants."""
        unknown = set(self.fitted) - {*Car._fields, "R_v"}
        if unknown:
            raise ValueError(f"a car has no constant {', '.join(sorted(unknown))}")
        return self


class SavedNewtonEuler(SavedPart):
    """The JSON part of a saved Newton-Euler model."""

    car: SavedCar
    period_s: Period
    facts: FitFacts


class EffectFacts(SavedFacts):
    """What a diagnosis states of its car with effects: what it refitted, and standard errors by constant and field."""

    fitted: tuple[str, ...] = ()
    se: dict[str, Undetermined | None] = Field(default_factory=dict)
