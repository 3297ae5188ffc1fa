"""Tables in LaTeX: ruled by booktabs, all that is text escaped, numbers aligned at ± and at the dash of an interval."""

import re

from bcid.report.formats import format_number, format_thousandths, format_with_error, symbol_text
from bcid.view.tables import Between, Cell, Estimated, Printing, ResultTable

SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}",
}  # fmt: skip
"""What LaTeX would take for a command."""

GREEK_NAMES = {
    "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta", "ε": "varepsilon", "κ": "kappa", "μ": "mu", "ρ": "rho",
    "σ": "sigma", "τ": "tau", "φ": "varphi", "ψ": "psi", "ω": "omega", "Ω": "Omega", "Δ": "Delta",
}  # fmt: skip
SIGNS = {
    "±": r"\pm", "×": r"\times", "·": r"\cdot", "−": "-",
    **{letter: f"\\{name}" for letter, name in GREEK_NAMES.items()},
}  # fmt: skip
"""Letters and signs that LaTeX has in formulas only."""
RAISED = dict(zip("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789", strict=True))
DASHES = {"–": "--", "—": "---", "…": r"\dots{}", "µ": r"$\mu$", "°": r"$^{\circ}$"}

PREAMBLE = "% in the preamble: \\usepackage{booktabs}"
NOTHING = "--"
SYMBOL_COLUMNS = ("parameter", "symbol")
"""Columns whose texts are symbols of parameters."""


def escape_latex(text: str) -> str:
    r"""A text as LaTeX prints it: special characters escaped, Greek letters and raised digits as formulas.

    Other letters stay, which LaTeX reads as UTF-8.

    >>> escape_latex("rough_patch: 50 % of N s²/m² & τ")
    'rough\\_patch: 50 \\% of N s$^{2}$/m$^{2}$ \\& $\\tau$'
    """
    parts = re.split(f"([{''.join(RAISED)}]+)", text)
    raised = (f"$^{{{''.join(RAISED[c] for c in part)}}}$" for part in parts[1::2])
    plain = ("".join(_escape_character(c) for c in part) for part in parts[::2])
    pairs = zip(plain, [*raised, ""], strict=True)
    return "".join(piece for pair in pairs for piece in pair)


def _escape_character(c: str) -> str:
    """One character as LaTeX prints it."""
    if c in SIGNS:
        return f"${SIGNS[c]}$"
    # what a terminal might obey, and a line's end in a cell, are blanks
    return SPECIAL.get(c) or DASHES.get(c) or (c if c.isprintable() else " ")


def format_symbol(symbol: str) -> str:
    r"""A symbol such as C_f or tau as a formula, its index upright; a name of several letters as text.

    >>> format_symbol("C_f"), format_symbol("tau"), format_symbol("radius"), format_symbol("F_f_max")
    ('$C_{\\mathrm{f}}$', '$\\tau$', 'radius', '$F_{\\mathrm{f,max}}$')
    """
    base, _, index = symbol.partition("_")
    shown = symbol_text(base)
    letter = SIGNS.get(shown, shown if len(shown) == 1 and shown.isalpha() and shown.isascii() else "")
    if not letter or not re.fullmatch(r"[A-Za-z0-9_]*", index):
        return escape_latex(symbol)
    return f"${letter}_{{\\mathrm{{{index.replace('_', ',')}}}}}$" if index else f"${letter}$"


def table_as_latex(table: ResultTable) -> str:
    """A table with its caption and the label `tab:NAME`; it needs the package booktabs."""
    kinds = [type(next((c for c in column if c is not None), "")) for column in zip(*table.rows, strict=True)]
    heads = [_heading(table, column, _width(kind)) for column, kind in zip(table.columns, kinds, strict=True)]
    rows = [
        " & ".join(
            _format_cell(cell, kind, column, table.printed.get(column))
            for cell, kind, column in zip(row, kinds, table.columns, strict=True)
        )
        for row in table.rows
    ]
    lines = [
        PREAMBLE, r"\begin{table}", r"\centering", rf"\caption{{{escape_latex(table.caption)}.}}",
        rf"\label{{tab:{table.name}}}", rf"\begin{{tabular}}{{{''.join(map(_alignment, kinds))}}}", r"\toprule",
        rf"{' & '.join(heads)} \\", r"\midrule", *(rf"{row} \\" for row in rows), r"\bottomrule", r"\end{tabular}",
        r"\end{table}",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _heading(table: ResultTable, column: str, width: int) -> str:
    """A column's name over `width` columns of LaTeX, with its unit, or the power of ten of its numbers."""
    unit = table.units.get(column)
    shown = rf"{format_symbol(column)} ({escape_latex(unit)})" if unit else format_symbol(column)
    shown += r" $\times 10^{3}$" if table.printed.get(column) == "thousandths" else ""
    return rf"\multicolumn{{{width}}}{{c}}{{{shown}}}" if width > 1 else shown


def _width(kind: type) -> int:
    """How many columns of LaTeX a column of a kind takes."""
    return 2 if kind is Estimated else 3 if kind is Between else 1


def _alignment(kind: type) -> str:
    """How cells of a kind are aligned: a number by its right end, its error by its left; a text by its left."""
    if kind is Estimated:
        return r"r@{${}\pm{}$}l"
    if kind is Between:
        return r"rr@{--}l"
    return "r" if kind in (int, float) else "l"


def _format_cell(cell: Cell, kind: type, column: str, printed: Printing | None) -> str:
    """A cell as LaTeX, with & between the columns that it takes."""
    if cell is None:
        return NOTHING
    if isinstance(cell, Estimated):
        return _format_estimated(cell)
    if isinstance(cell, Between):
        low, high = (None if v is None else _format_value(v, printed) for v in (cell.low, cell.high))
        ends = rf"\multicolumn{{2}}{{c}}{{{NOTHING}}}" if low is None or high is None else f"{low} & {high}"
        return f"{_format_value(cell.value, printed)} & {ends}"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, str):
        return format_symbol(cell) if column in SYMBOL_COLUMNS else escape_latex(cell.replace("_", " "))
    return str(cell) if kind is int else _format_value(cell, printed)


def _format_value(value: float | None, printed: Printing | None) -> str:
    """A number as LaTeX; a dash where there is none."""
    if value is None:
        return NOTHING
    if printed == "as given":
        return escape_latex(f"{value:g}")
    return escape_latex(format_thousandths(value) if printed == "thousandths" else format_number(value))


def _format_estimated(cell: Estimated) -> str:
    """A number and its error, both rounded to the error, each in its column; a power of ten stands behind the error."""
    text = format_with_error(cell.value, cell.se)
    power = re.fullmatch(r"\((.*)\)( × 10.*)", text)
    value, _, error = (power[1] if power else text).partition(" ± ")
    if not error:
        return rf"\multicolumn{{2}}{{c}}{{{escape_latex(text)}}}"
    if power:
        value, error = f"({value}", f"{error}){power[2]}"
    return f"{escape_latex(value)} & {escape_latex(error)}"
