"""A program that runs the adapting filter in C over the first poses of a recording, and compares it with ours."""

from __future__ import annotations

import numpy as np

from bcid.adaptation.adapt import Adaptation
from bcid.adaptation.filter import start_filter
from bcid.adaptation.filter_run import run_filter
from bcid.export.check_programs import c_table

PERIODS = 200
"""Periods that are compared, fewer where a stretch is shorter."""
TOLERANCE = 1e-9
"""Largest error of a number of z, relative for those beyond 1."""
VARIANCE_TOLERANCE = 1e-6
"""Largest relative error of a quantity's variance, which is what large numbers leave of each other."""

_PROGRAM = """\
/* Runs the filter of {name} over {count} poses of a recording, and compares it with bcid's own.
 *
 *   cc -std=c99 -O2 {name}_adapt.c {name}_adapt_test.c -lm -o {name}_adapt_test && ./{name}_adapt_test
 */
#include <math.h>
#include <stdio.h>

#include "{name}_adapt.h"

#define COUNT {count}

static const double first_pose[3] = {pose};
static const double first_twist[3] = {twist};
static const double commands[COUNT][2] = {commands};
static const double poses[COUNT][3] = {poses};
static const int measured[COUNT] = {measured};
static const double expected[COUNT][{N}_NUMBERS] = {expected};
static const double expected_variances[COUNT][{N}_NUMBERS] = {variances};

int main(void)
{{
    {name}_adapt_filter f;
    double worst = 0.0, worst_variance = 0.0;
    int k, i;
    {name}_adapt_init(&f, first_pose, first_twist, {delta!r});
    for (k = 0; k < COUNT; ++k) {{
        {name}_adapt_step(&f, commands[k], measured[k] ? poses[k] : NULL);
        for (i = 0; i < {N}_NUMBERS; ++i) {{
            const double error = fabs(f.z[i] - expected[k][i]) / fmax(1.0, fabs(expected[k][i]));
            if (!(error <= worst)) worst = error == error ? error : HUGE_VAL;
        }}
        for (i = {states}; i < {N}_NUMBERS; ++i) {{
            const double error = fabs(f.P[i][i] / expected_variances[k][i] - 1.0);
            if (!(error <= worst_variance)) worst_variance = error == error ? error : HUGE_VAL;
        }}
    }}
    printf("%.3e %.3e\\n", worst, worst_variance);
    return worst <= {tolerance!r} && worst_variance <= {variance_tolerance!r} ? 0 : 1;
}}
"""


def write_adapt_test(name: str, adaptation: Adaptation) -> str:
    """The text of NAME_adapt_test.c: the longest stretch of the recording's first motion, as far as `PERIODS` go.

    Of a car that never moves it is the longest of all.
    """
    moving = adaptation.drive.first_motion(adaptation.filter.least_mps, PERIODS * adaptation.formulas.period_s)
    drive = moving if moving.stretches() else adaptation.drive
    estimate, rows = drive.estimate, max(drive.stretches(), key=lambda rows: rows.stop - rows.start)
    first, count = rows.start, min(PERIODS, rows.stop - rows.start - 1)
    delta = float(estimate.kinematic[first, 3])
    commands = np.ascontiguousarray(estimate.command[first : first + count])
    poses = drive.poses[first + 1 : first + 1 + count]
    z, P = start_filter(adaptation.formulas, adaptation.noise, estimate.pose[first], estimate.twist[first], delta)
    run = run_filter(adaptation.filter, z, P, commands, poses)
    measured = ~np.isnan(poses[:, 0])
    return _PROGRAM.format(
        name=name, N=f"{name.upper()}_ADAPT", count=count, delta=delta, tolerance=TOLERANCE,
        pose=c_table(estimate.pose[first].tolist()), twist=c_table(estimate.twist[first].tolist()),
        commands=c_table(commands.tolist()), poses=c_table(np.where(measured[:, None], poses, 0.0).tolist()),
        measured="{" + ", ".join(str(int(m)) for m in measured) + "}", expected=c_table(run.z.tolist()),
        variances=c_table(run.variance.tolist()), states=len(adaptation.formulas.states),
        variance_tolerance=VARIANCE_TOLERANCE,
    )  # fmt: skip
