"""The catalogue and the counts of faults as the docs show them."""

from __future__ import annotations

from typing import Any

from faults.fuzzing import FAILURES

NAMES = {"\x1b": "ESC", "\x00": "NUL"}
"""Of what nobody sees."""


def catalogue_table(golden: dict[str, dict[str, list[str]]]) -> str:
    """What is said of each input: a refusal's cause and next step, or what is told of a take that is read."""
    rows = ["| # | input | what comes of it |", "|---|---|---|"]
    for number, tries in golden.items():
        for label, (outcome, *lines) in tries.items():
            said = f"**refused** {' — '.join(line.strip() for line in lines)}" if outcome == "refused" else "read"
            if outcome == "read" and lines:
                said += f"; {'; '.join(lines)}"
            cells = [number, label, said]
            rows.append("| " + " | ".join(_plain(c) for c in cells) + " |")
    return "\n".join(rows)


def _plain(text: str) -> str:
    """Text that Markdown shows as it is, and that any viewer takes for text."""
    for sign in ("|", "<", ">", "[", "]", "_"):
        text = text.replace(sign, f"\\{sign}")
    return "".join(sign if sign.isprintable() else NAMES.get(sign, "\N{REPLACEMENT CHARACTER}") for sign in text)


def faults_table(found: dict[str, Any]) -> str:
    """Mutants by kind of file, and what came of them."""
    shown = ("refused", "read", "read, the same", "read, changed")
    rows = [
        f"| kind of file | mutants | {' | '.join(FAILURES)} | refused | read | peak (MiB) |",
        "|---|---|" + "---|" * (len(FAILURES) + 3),
    ]
    for kind, counts in found["kinds"].items():
        bad = " | ".join(str(counts.get(f, 0)) for f in FAILURES)
        n = sum(counts.get(k, 0) for k in (*FAILURES, *shown) if k != "memory")
        read = sum(counts.get(k, 0) for k in shown[1:])
        rows.append(f"| {kind} | {n} | {bad} | {counts.get('refused', 0)} | {read} | {counts['peak_mib']} |")
    return "\n".join(rows)


def kills_told(found: dict[str, Any]) -> str:
    """How runs ended after a kill."""
    same, twice = found["outcomes"].get("same", 0), "have" if found["two_runs_the_same"] else "do not have"
    return f"""
`make kills N={found["kills"]}` kills a whole pipeline ({found["undisturbed_s"]:.0f} s undisturbed) at random moments:
{same} of {found["kills"]} next runs ended with the same bytes in every file as an undisturbed one. Two undisturbed runs
{twice} the same bytes.
"""


def counts_told(found: dict[str, Any]) -> str:
    """What was counted of the format's own files, of flipped bits and of files that expand."""
    noticed, of_each = found["flips"]["noticed"], found["flips"]["of_each"]
    suite, lines = found["conformance"], []
    lines.append(
        f"- {suite['as_described']} of the {suite['files']} files of the MCAP format's conformance suite read as "
        "their descriptions say."
    )
    lines.append(
        f"- {sum(noticed.values())} of {of_each * len(noticed)} flipped bits in artifacts are noticed, "
        f"{of_each} in each of {', '.join(noticed)}."
    )
    for name, b in found["bombs"].items():
        outcome = "refused" if b["refused"] else "**read**"
        lines.append(
            f"- {b['bytes'] / 1e3:.0f} kB, {name}: {outcome} after {b['seconds']:.2f} s and {b['mib']:.0f} MiB beyond "
            "start-up."
        )
    return "\n".join(lines)
