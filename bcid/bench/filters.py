"""Times of the EKF and its smoother beside C and filterpy."""

import ctypes
from collections.abc import Iterator
from functools import partial

import numpy as np

from bcid.aliases import Floats
from bcid.bench.c_code import load_source, numbers, pointer
from bcid.bench.limits import SPEED
from bcid.bench.timing import Skipped, TimedPeer, Timing, Work, require, time_against_peers
from bcid.estimate import kernel
from bcid.estimate.events import build_chassis, build_timeline
from bcid.estimate.filter_step import MAX_STEP_S
from bcid.estimate.kernel import Events
from bcid.estimate.process import N_STATE, Chassis
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

FILTERED_S = 20.0  # s of poses that the filters work on


def time_filters(repeats: int) -> Iterator[Timing | Skipped]:
    """Yield timings of our compiled EKF and RTS smoother against C and filterpy, on 20 s of poses.

    Times are medians of `repeats` turns; `difference` is the largest between the states.
    """
    vehicle = simulated_vehicle()
    drive = simulate_drive(Plant(**REAL_EXTRAS), Sensor(dropouts_per_minute=0.0), FILTERED_S, 1)
    T_s, d, noise = TUNING.T_s, TUNING.d, TUNING.noise
    events = build_timeline(record_drive(drive, 60.0, vehicle), vehicle, 0.1, 0.3, T_s, d).events
    task = events, build_chassis(vehicle, T_s, d), noise.Q(), noise.R()
    peers = {
        "C by hand": TimedPeer(partial(_filter_in_c, *task), SPEED.c_filter, SPEED.max_difference),
        "filterpy": TimedPeer(partial(_filter_by_filterpy, *task), SPEED.filterpy_filter, SPEED.max_difference),
    }
    longest_ms = 1e-3 * SPEED.longest_event_us * len(events.time_s)
    path = f"EKF, {len(events.time_s)} events"
    yield from time_against_peers(path, lambda: kernel.run_filter(*task).x, peers, repeats, longest_ms)
    filtered = kernel.run_filter(*task)

    def by_filterpy() -> Work:
        require("filterpy")
        from bcid.estimate import reference

        return lambda: reference.run_smoother(filtered, events.restart)[0]

    smoother = {"filterpy": TimedPeer(by_filterpy, SPEED.filterpy_smoother, SPEED.max_difference)}
    ours = lambda: kernel.run_smoother(filtered, events.restart)[0]  # noqa: E731
    yield from time_against_peers("RTS smoother", ours, smoother, repeats)


def _filter_by_filterpy(events: Events, c: Chassis, Q: Floats, R: Floats) -> Work:
    """The forward pass by filterpy's `ExtendedKalmanFilter`: the call that gives states (M, 7)."""
    require("filterpy")
    from bcid.estimate import reference

    return lambda: reference.run_filter(events, c, Q, R).x


def _filter_in_c(events: Events, c: Chassis, Q: Floats, R: Floats) -> Work:
    """Compile the forward pass in C; return the call that gives states (M, 7), for events without a restart."""
    if events.restart[1:].any() or np.isfinite(events.z[:, 5]).any():
        raise ValueError("the filter in C knows no interruption and no wheel speed")
    library, M = load_source("filter.c"), len(events.time_s)
    given = [numbers(a) for a in (events.time_s, events.u_s, np.nan_to_num(events.z))]
    # a compiler that is told to compute fast does not know NaN
    known = np.ascontiguousarray(np.isfinite(events.z), dtype=np.int32)
    others = [numbers(a) for a in (events.x_0[0], events.P_0, c[:4], Q, R)]

    def run() -> Floats:
        states, matrices = (
            [np.empty((M, N_STATE)) for _ in range(2)],
            [np.empty((M, N_STATE, N_STATE)) for _ in range(3)],
        )
        out = [states[0], matrices[0], states[1], matrices[1], matrices[2]]
        library.filter(
            *map(pointer, given), pointer(known), *map(pointer, others), ctypes.c_double(MAX_STEP_S), ctypes.c_long(M),
            *map(pointer, out),
        )  # fmt: skip
        return states[0]

    return run
