"""The formulas of a Newton-Euler car with effects: actuators and body of one period, traced.

A model's own step keeps when each command was given.  Here commands come at the beginning of each period, so that how
far a delayed one has come is a number, and of the past only the commands are left, and those states that its effects
ask for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from bcid.effects.actuators import SteeringState, actuation_at, continue_actuator_chain
from bcid.effects.car import BodyState, LagState
from bcid.effects.constants import Constants
from bcid.effects.corrections import MEASURED_SPEED
from bcid.effects.motion import integrate_body, steady_lags
from bcid.effects.own_laws import call_law
from bcid.effects.table import ENTRIES
from bcid.errors import UsageError
from bcid.export.formulas import (
    CENTRE_OF_GRAVITY,
    COMMANDS,
    POSE,
    START,
    STEERED,
    TWIST,
    StepFormulas,
    Variable,
    as_nodes,
    name_constants,
    periods_ago,
)
from bcid.export.graph import Graph
from bcid.export.model_formulas import FLAGS
from bcid.export.trace import Tracer
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler, max_command_delay
from bcid.models.newton_euler.augmented_step import (
    AugmentedSetup,
    body_from_tracked,
    command_arrivals,
    tracked_twist,
)
from bcid.physics.car import Car

BODY = tuple(q._replace(meaning=f"{q.meaning}, of the {CENTRE_OF_GRAVITY}") for q in (*POSE, *TWIST))
LAGS = (
    Variable("alpha_f", "rad", "lagging slip angle of the front wheel"),
    Variable("F_mf", "N", "lagging motor force at a front wheel"),
    Variable("F_mr", "N", "lagging motor force at a rear wheel"),
)
STEERING = (
    STEERED._replace(meaning="angle of the servo, left positive"),
    Variable("delta_lagged", "rad", "steering angle behind its further lag"),
    Variable("delta_behind", "rad", "steering angle behind its play"),
)
TIME = Variable("t", "s", "time since the recording began, on which effects depend")
TIMED = ("steering_delay__tau", "motor_delay__tau", "throttle_timing__tau", "pose_latency__tau", "clock_drift__rho")
"""Parameters of the effects that shift commands in time."""

DRIFTS = "clock_drift__rho"
SAME_TIME_PERIODS = 1e-9
# Steps of the compliance's regula falsi, which are all written out.  At the bounds of compliance, and of what bends a
# tyre's force, twelve leave 3e-6, sixteen end within rounding.
COMPLIANCE_STEPS = 16


class NamedModel(NamedTuple):
    """What a car's equations take beside its state, with named constants; times and lengths of time are numbers."""

    tracer: Tracer
    car: Any
    constants: Any
    switches: Any
    setup: AugmentedSetup

    @property
    def h(self) -> float:
        """An integration step (s)."""
        return self.setup.period / self.setup.steps


def trace_augmented(model: AugmentedNewtonEuler, time_s: float | None = None) -> StepFormulas:
    """The formulas of a car with effects.

    What depends on the time of the recording does so on a state, or stands as it was at `time_s` (s) where that is
    given.

    Raises:
        UsageError: a clock drifts, and no time is given: commands would act at another time in every period.
    """
    if drifts(model) and time_s is None:
        raise UsageError(
            "the model has a clock that drifts, so that commands act later and later\n"
            "  next: give --time SECONDS of the recording, or --as vehicle, which leaves the clock out"
        )
    return trace_named_model(name_model(model), model, time_s)


def trace_named_model(named: NamedModel, model: AugmentedNewtonEuler, time_s: float | None = None) -> StepFormulas:
    """The formulas of a car with effects whose constants are `named`, in the graph of these; see `trace_augmented`."""
    graph, past = named.tracer.graph, _past_commands(model)
    states = (*BODY, *LAGS, *STEERING, TIME, *past)
    now = graph.input(TIME.name) if time_s is None else time_s
    after, twist = _advance(named, model, past, now, time_s or 0.0)
    first = _begin(named, past, 0.0 if time_s is None else time_s)
    formulas = StepFormulas(
        graph, model.period_s, states, as_nodes(graph, after), as_nodes(graph, twist), as_nodes(graph, first), {}
    )
    return formulas.without_idle_states([quantity.name for quantity in BODY])


def name_model(model: AugmentedNewtonEuler) -> NamedModel:
    """The model with its constants and its effects' parameters named, in a graph of their own."""
    # laws of the user's are not named by the car, but found by it: they are traced as they are called
    own: dict[Any, Any] = {call_law: lambda law, values: tracer.trace(law.function)(*values)}
    tracer: Tracer = Tracer(Graph(), own, {"MAX_COMPLIANCE_STEPS": COMPLIANCE_STEPS})
    graph, setup = tracer.graph, model.setup
    names = setup.switches.dtype.names
    on = {name: float(setup.switches[name]) for name in model.effects}
    values = {name: setup.switches[name] for name in names} | name_constants(graph, on, TIMED)
    switches = SimpleNamespace(**values)
    car = Car(**name_constants(graph, setup.car._asdict(), FLAGS))
    return NamedModel(tracer, car, Constants(**name_constants(graph, setup.constants._asdict())), switches, setup)


def _advance(
    named: NamedModel, model: AugmentedNewtonEuler, past: Sequence[Variable], now: Any, time_s: float
) -> tuple[list[Any], Sequence[Any]]:
    """All states after a period that begins at `now`, and the twist that is seen then.

    How late commands act is taken as at `time_s` (s) of the recording.
    """
    tracer, car, constants, switches, setup = named
    inputs: Any = tracer.graph.input
    given_s, commands = _list_commands(tracer.graph, past, setup.period)
    angle, lagged, behind = (inputs(quantity.name) for quantity in STEERING)
    begin = SteeringState(angle, lagged if model.effects.get("steering_lag__tau") else angle, behind)
    chain, steering = tracer.trace(continue_actuator_chain)(
        begin,
        command_arrivals(time_s + given_s[:, None], setup) - time_s,
        commands,
        0.0,
        setup.steps,
        named.h,
        car,
        setup.limit,
        switches,
    )
    body = BodyState(*(inputs(quantity.name) for quantity in BODY))
    lags = LagState(*(inputs(quantity.name) for quantity in LAGS))
    rows = tracer.trace(integrate_body)(
        body, lags, 0, setup.steps, chain._replace(t_0=now), setup.T, np.zeros((1, 3)), setup.steps, car, switches,
        constants,
    )  # fmt: skip
    twist = tracer.trace(tracked_twist)(BodyState(*rows[-1][:6]), switches)
    given = [inputs(quantity.name) for quantity in (*COMMANDS, *past)]
    return [*rows[-1], *steering, now + setup.period, *given[: len(past)]], twist


def _begin(named: NamedModel, past: Sequence[Variable], time_s: float) -> list[Any]:
    """All states at `time_s` (s) of a car that coasts, its wheel held where it is."""
    tracer, car, constants, switches, setup = named
    start: Any = [tracer.graph.input(quantity.name) for quantity in START]
    delta = start[6]
    body = tracer.trace(body_from_tracked)(start[:3], start[3:6], switches)
    still, _ = tracer.trace(continue_actuator_chain)(
        SteeringState(delta, delta, delta), np.array([-setup.period]), np.array([[delta, 0.0, 0.0]], object), 0.0,
        setup.steps, named.h, car, math.inf, switches,
    )  # fmt: skip
    act = tracer.trace(actuation_at)(0, still, setup.T)._replace(t=time_s)
    lags = tracer.trace(steady_lags)(body, act, car, switches, constants)
    return [*body, *lags, delta, delta, delta, time_s, *(delta if quantity.unit else 0.0 for quantity in past)]


def drifts(model: AugmentedNewtonEuler) -> bool:
    """Whether the clock of the poses drifts, so that commands act later and later."""
    return bool(model.effects.get(DRIFTS))


def has_time(formulas: StepFormulas) -> bool:
    """Whether the time of the recording is a state."""
    return TIME in formulas.states


def leave_out_measurement(model: AugmentedNewtonEuler) -> AugmentedNewtonEuler:
    """The car itself: the model without the effects of how its poses, and its wheel's speed, were measured."""
    measured = {f for e in ENTRIES.values() if e.kind == "measurement" or e.id in MEASURED_SPEED for f in e.fields}
    return replace(model, effects={f: x for f, x in model.effects.items() if f not in measured})


def _past_commands(model: AugmentedNewtonEuler) -> tuple[Variable, ...]:
    """The commands before this one that still act or have not yet, newest first, as states: of the longest delay."""
    delay = max_command_delay(model.setup.switches, model.recording_s)
    count = max(math.ceil(delay / model.period_s - SAME_TIME_PERIODS), 0)
    return tuple(
        Variable(f"{command.name}_ago_{k}", command.unit, f"command {periods_ago(k)}")
        for k in range(1, count + 1)
        for command in COMMANDS
    )


def _list_commands(graph: Graph, past: Sequence[Variable], period_s: float) -> tuple[Any, Any]:
    """When commands were given (n,) (s), 0 now, and the commands (n, 3) as nodes, oldest first."""
    given = [graph.input(quantity.name) for quantity in (*COMMANDS, *past)]
    rows = [[u_s, u_m, 0.0] for u_s, u_m in zip(given[::2], given[1::2], strict=True)]
    return -period_s * np.arange(len(rows) - 1, -1, -1.0), np.array(rows[::-1], object)
