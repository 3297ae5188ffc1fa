"""The filter that adapts a car in C99: NAME_adapt.h and NAME_adapt.c, of doubles and `math.h` alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bcid.adaptation.filter import CompiledFilter, FilterNoise, first_variances, settling_poses, split_slopes
from bcid.adaptation.filter_run import BOUND_ROUNDS, JUMP_POSES, OUTLIER
from bcid.adaptation.formulas import AdaptiveFormulas
from bcid.aliases import Floats, Ints
from bcid.export.augmented_formulas import TIME
from bcid.export.c_source import HELPERS, C, describe_all, element_texts, places_in, write_function
from bcid.export.formulas import COMMANDS, START, Variable
from bcid.export.graph import Node
from bcid.export.statements import Program, write_program

_HEADER = """\
/* {about}, whose {names} are estimated while it drives.
 *
 * z holds the state, then the estimated quantities, and P their covariance:
{numbers}
 * Command, held for one period of {period!r} s:
{commands}
 * Pose [p_x, p_y (m), theta (rad)] in the world, as it is measured.
 */
#ifndef {guard}_H
#define {guard}_H

#ifdef __cplusplus
extern "C" {{
#endif

#define {guard}_NUMBERS {N}
#define {guard}_PERIOD_S {period!r}

typedef struct {{
    double z[{N}];
    double P[{N}][{N}];
    int settling; /* poses from which nothing more is learnt of the quantities */
}} {name}_adapt_filter;

/* Begin at a pose, a twist [v_x, v_y (m/s), yaw rate (rad/s)] and a steering angle (rad); the past is not known.  The
 * twist is NULL, and the angle not a number, where nobody knows them: then poses show them, and nothing else is learnt
 * from those of the first second. */
void {name}_adapt_init({name}_adapt_filter *f, const double pose[3], const double *twist, double delta);

/* Begin anew after a gap of so many seconds (0 or more) since the last step: the state is lost, and what is known of
 * the quantities stays, less what is forgotten in that time. */
void {name}_adapt_restart({name}_adapt_filter *f, const double pose[3], const double *twist, double delta,
    double gap_s);

/* One period under a command, and the pose measured at its end; NULL, or not a number, where none was. */
void {name}_adapt_step({name}_adapt_filter *f, const double u[2], const double *pose);

#ifdef __cplusplus
}}
#endif

#endif
"""

_LOOPS = """\
/* A share of what was learnt of the quantities fades: their variances go back towards those at first. */
static void forget({name}_adapt_filter *f, double share)
{{
    const double kept = sqrt(1.0 - share);
    int i, j;
    for (i = NX; i < N; ++i) {{
        for (j = 0; j < N; ++j) {{
            f->P[i][j] *= kept;
            f->P[j][i] *= kept;
        }}
    }}
    for (i = NX; i < N; ++i) f->P[i][i] += share * variances[i];
}}

void {name}_adapt_init({name}_adapt_filter *f, const double pose[3], const double *twist, double delta)
{{
    int i;
{clock_begins}    for (i = 0; i < K; ++i) f->z[NX + i] = quantities[i];
    for (i = 0; i < N * N; ++i) f->P[i / N][i % N] = 0.0;
    for (i = 0; i < K; ++i) f->P[NX + i][NX + i] = variances[NX + i];
    {name}_adapt_restart(f, pose, twist, delta, 0.0);
}}

void {name}_adapt_restart({name}_adapt_filter *f, const double pose[3], const double *twist, double delta,
    double gap_s)
{{
    static const double still[3] = {{0.0, 0.0, 0.0}};
    const int wheel_known = delta == delta;
    double G[NX][K];
{clock}    int i, j, m;
    forget(f, -expm1(-gap_s / FORGET_S));
    first_states(pose, twist != NULL ? twist : still, wheel_known ? delta : 0.0, f->z + NX, f->z, G);
{clock_goes_on}    for (i = 0; i < NX; ++i) {{
        for (j = 0; j < N; ++j) f->P[i][j] = f->P[j][i] = 0.0;
        f->P[i][i] = variances[i];
        if (twist == NULL && twist_unknown[i] > 0.0) f->P[i][i] = twist_unknown[i];
        if (!wheel_known && wheel_unknown[i] > 0.0) f->P[i][i] = wheel_unknown[i];
    }}
    /* what a pose says of the state depends on the quantities */
    for (i = 0; i < NX; ++i) {{
        for (j = NX; j < N; ++j) {{
            double total = 0.0;
            for (m = 0; m < K; ++m) total += G[i][m] * f->P[NX + m][j];
            f->P[i][j] = f->P[j][i] = total;
        }}
    }}
    for (i = 0; i < NX; ++i) {{
        for (j = 0; j < NX; ++j) {{
            for (m = 0; m < K; ++m) f->P[i][j] += f->P[i][NX + m] * G[j][m];
        }}
    }}
    f->settling = twist == NULL || !wheel_known ? SETTLING : 0;
}}

/* P = F P F' + Q, below F the rows of the unit matrix. */
static void predict_covariance(double P[N][N], double F[NX][N])
{{
    double FP[N][N];
    int i, j, m;
    for (i = 0; i < N; ++i) {{
        for (j = 0; j < N; ++j) FP[i][j] = i < NX ? 0.0 : P[i][j];
        for (m = 0; i < NX && m < N; ++m) {{
            const double slope = F[i][m];
            if (slope == 0.0) continue;
            for (j = 0; j < N; ++j) FP[i][j] += slope * P[m][j];
        }}
    }}
    for (i = 0; i < N; ++i) {{
        for (j = i; j < N; ++j) {{
            double total = j < NX ? 0.0 : FP[i][j];
            for (m = 0; j < NX && m < N; ++m) total += FP[i][m] * F[j][m];
            P[i][j] = P[j][i] = total;
        }}
        P[i][i] += pushes[i];
    }}
}}

/* Quantities that have left their bounds are set to these, and all else goes with them. */
static void keep_within({name}_adapt_filter *f)
{{
    int round, i, j;
    for (round = 0; round < BOUND_ROUNDS; ++round) {{
        for (i = NX; i < N; ++i) {{
            const double bound = fmin(fmax(f->z[i], lowest[i - NX]), largest_of[i - NX]), off = bound - f->z[i];
            if (off == 0.0 || !(f->P[i][i] > 0.0)) continue;
            for (j = 0; j < N; ++j) f->z[j] += f->P[j][i] * off / f->P[i][i];
            f->z[i] = bound;
        }}
    }}
    for (i = NX; i < N; ++i) f->z[i] = fmin(fmax(f->z[i], lowest[i - NX]), largest_of[i - NX]);
}}

/* Whether the car moves: while it stands nothing is learnt of the quantities. */
static int moves(const double z[N])
{{
    const double turning = WHEELBASE_M * z[YAW_RATE];
    return z[V_X] * z[V_X] + z[V_Y] * z[V_Y] + turning * turning > LEAST_MPS * LEAST_MPS;
}}

/* A measured pose enters, one number after the other; a wrong one moves the state by a bounded amount, and makes the
 * place less certain, so that some that agree are right. */
static void update({name}_adapt_filter *f, const double pose[3])
{{
    double h[3], H[3][N], PH[N];
    const int learns = f->settling == 0 && moves(f->z);
    int c, i, j;
    for (c = 0; c < 3; ++c) {{
        double e, at_most, doubt, s = pose_variances[c];
        seen_pose(f->z, h, H);
        e = pose[c] - h[c];
        if (c == 2) e -= 2.0 * PI * floor((e + PI) / (2.0 * PI));
        for (i = 0; i < N; ++i) {{
            PH[i] = 0.0;
            for (j = 0; j < N; ++j) PH[i] += f->P[i][j] * H[c][j];
        }}
        for (i = 0; i < N; ++i) s += H[c][i] * PH[i];
        at_most = e * e / (OUTLIER * OUTLIER);
        doubt = at_most > s ? at_most / JUMP_POSES : 0.0;
        s = fmax(s, at_most);
        for (i = 0; i < N; ++i) {{
            if (i < NX || learns) f->z[i] += PH[i] * e / s;
            for (j = 0; j < N; ++j) {{
                if (i < NX || j < NX || learns) f->P[i][j] -= PH[i] * PH[j] / s;
            }}
        }}
        f->P[places[c]][places[c]] += doubt;
    }}
    keep_within(f);
}}

void {name}_adapt_step({name}_adapt_filter *f, const double u[2], const double *pose)
{{
    double x[NX], F[NX][N];
    int i;
    advance(f->z, u, x, F);
    forget(f, FORGOTTEN);
    predict_covariance(f->P, F);
    for (i = 0; i < NX; ++i) f->z[i] = x[i];
    if (pose != NULL && pose[0] == pose[0] && pose[1] == pose[1] && pose[2] == pose[2]) {{
        update(f, pose);
        if (f->settling > 0) --f->settling;
    }}
}}
"""


def write_adapt_header(name: str, about: str, formulas: AdaptiveFormulas, commands: Sequence[Variable]) -> str:
    """The text of NAME_adapt.h; `about` is the sentence at the head of every file of this model."""
    quantities = [
        Variable(q.name, "" if q.is_factor else q.unit, f"factor on {', '.join(q.constants)}" if q.is_factor else "")
        for q in formulas.quantities
    ]
    return _HEADER.format(
        name=name, guard=f"{name.upper()}_ADAPT", about=about, names=", ".join(q.name for q in quantities),
        numbers=describe_all("z", [*formulas.states, *quantities]), commands=describe_all("u", commands),
        period=formulas.period_s, N=len(formulas.states) + len(quantities),
    )  # fmt: skip


def write_adapt_source(name: str, about: str, formulas: AdaptiveFormulas, f: CompiledFilter, noise: FilterNoise) -> str:
    """The text of NAME_adapt.c: the filter `f` of `formulas`, which assumes `noise`."""
    n, k = len(formulas.states), len(formulas.quantities)
    named = [Variable(q.symbol, q.unit, "") for q in formulas.quantities]
    in_z = places_in([*formulas.states, *named], "z")
    step = write_program([*formulas.next_states, *_varying(formulas.slopes)], C)
    pose = write_program([*formulas.pose, *_varying(formulas.pose_slopes)], C)
    first = write_program([*formulas.first_states, *_varying(formulas.first_slopes)], C)
    G, G_places = split_slopes(formulas.first_slopes)
    starts = places_in(START[:3], "pose") | places_in(START[3:6], "twist") | {START[6].name: "delta"}
    programs = (step, pose, first)
    used = frozenset[str]().union(*(program.operations for program in programs))
    parameters = {key: value for program in programs for key, value in program.parameters.items()}
    blocks = [
        f'/* {about} */\n\n#include "{name}_adapt.h"\n\n#include <math.h>\n#include <stddef.h>\n',
        f"#define NX {n}\n#define K {k}\n#define N {n + k}\n"
        f"#define FORGET_S {noise.forget_s!r}\n#define FORGOTTEN {f.forgotten!r}\n"
        + "".join(f"#define {name} {place}\n" for name, place in zip(("V_X", "V_Y", "YAW_RATE"), f.twist, strict=True))
        + f"#define WHEELBASE_M {f.wheelbase_m!r}\n#define LEAST_MPS {f.least_mps!r}\n"
        f"#define OUTLIER {OUTLIER!r}\n#define JUMP_POSES {float(JUMP_POSES)!r}\n"
        f"#define SETTLING {settling_poses(formulas)}\n"
        f"#define BOUND_ROUNDS {BOUND_ROUNDS}\n#define PI 3.141592653589793\n",
        "".join(f"static const double {key} = {C.number(value)};\n" for key, value in parameters.items()),
        _table("quantities", [q.start for q in formulas.quantities]),
        _table("variances", first_variances(formulas, noise)),
        _table("twist_unknown", _only_changed(formulas, noise, twist_known=False)),
        _table("wheel_unknown", _only_changed(formulas, noise, wheel_known=False)),
        f"static const int places[] = {{{', '.join(map(str, f.place.tolist()))}}};\n",
        _table("pushes", f.Q), _table("pose_variances", f.r2), _table("lowest", f.low), _table("largest_of", f.high),
        "".join(f"{text}\n" for operation, text in HELPERS.items() if operation in used),
        _write_part("advance(const double z[N], const double u[2], double x[NX], double F[NX][N])", step,
                    in_z | places_in(COMMANDS, "u"), element_texts("x", n), f.F, f.F_places, "F", ["z", "u"]),
        _write_part("seen_pose(const double z[N], double h[3], double H[3][N])", pose, in_z, element_texts("h", 3),
                    f.H, f.H_places, "H", ["z"]),
        _write_part("first_states(const double pose[3], const double twist[3], double delta, const double q[K], "
                    "double x[NX], double G[NX][K])", first, starts | places_in(named, "q"), element_texts("x", n),
                    G, G_places, "G", ["pose", "twist", "delta", "q"]),
        _LOOPS.format(name=name, **_write_clock(formulas)),
    ]  # fmt: skip
    return "\n".join(block for block in blocks if block)


def _write_clock(formulas: AdaptiveFormulas) -> dict[str, str]:
    """The lines that let the time of the recording, where formulas depend on it, go on over a gap."""
    names = [state.name for state in formulas.states]
    if TIME.name not in names:
        return dict.fromkeys(("clock", "clock_goes_on", "clock_begins"), "")
    t = f"f->z[{names.index(TIME.name)}]"
    return {
        "clock": f"    const double now = {t} + gap_s;\n",
        "clock_goes_on": f"    {t} = now;\n", "clock_begins": f"    {t} = 0.0;\n",
    }  # fmt: skip


def _only_changed(formulas: AdaptiveFormulas, noise: FilterNoise, **known: bool) -> Floats:
    """The first variances (N,) of what is not `known`, zero elsewhere."""
    there = first_variances(formulas, noise, **known)
    return np.where(there != first_variances(formulas, noise), there, 0.0)


def _varying(slopes: Sequence[Sequence[Node]]) -> list[Node]:
    """The slopes that are not the same everywhere, row by row."""
    return [slope for row in slopes for slope in row if slope.value is None]


def _write_part(
    head: str, program: Program, places: dict[str, str], results: list[str], constant: Floats, varying: Ints,
    matrix: str, may_idle: list[str],
) -> str:  # fmt: skip
    """A function that fills in values and a matrix of slopes: `constant` ones, and those at the places `varying`."""
    at = [tuple(place) for place in varying.tolist()]
    fixed = "".join(
        f"    {matrix}[{i}][{j}] = {float(x)!r};\n"
        for i, row in enumerate(constant)
        for j, x in enumerate(row)
        if (i, j) not in at
    )
    targets = [*results, *(f"{matrix}[{i}][{j}]" for i, j in at)]
    text = write_function(f"static void {head}", program, places, targets, may_idle)
    return text[: -len("}\n")] + fixed + "}\n"


def _table(name: str, numbers: Sequence[float] | Floats) -> str:
    """A constant table of numbers."""
    return f"static const double {name}[] = {{{', '.join(repr(float(x)) for x in numbers)}}};\n"
