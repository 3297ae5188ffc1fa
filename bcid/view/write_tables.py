"""The tables of a workspace as files, in CSV and in LaTeX; all or none."""

import csv
from pathlib import Path

from bcid.documents.diagnosis import DiagnosisDocument
from bcid.documents.report import ReportDocument
from bcid.errors import InputRefused
from bcid.files.outputs import MayReplace, staged_outputs
from bcid.view.from_workspace import find_document
from bcid.view.latex import table_as_latex
from bcid.view.tables import ResultTable, csv_cells, csv_header, diagnosis_tables, report_tables


def workspace_tables(workspace: Path) -> list[ResultTable]:
    """The tables of the report and of the diagnosis in a workspace, without empty ones.

    Raises:
        InputRefused: the workspace holds neither, or they cannot be read.
    """
    report = find_document(workspace, "report", "report.json")
    diagnosis = find_document(workspace, "diagnosis", "diagnosis.json")
    if report is None and diagnosis is None:
        cause = "holds neither report.json nor diagnosis.json"
        raise InputRefused(workspace, "workspace", cause, "run `bcid report`, `bcid diagnose` or `bcid run` first")
    tables = report_tables(ReportDocument.read(report)) if report else []
    tables += diagnosis_tables(DiagnosisDocument.read(diagnosis)) if diagnosis else []
    return [table for table in tables if table.rows]


def write_tables(tables: list[ResultTable], folder: Path, may_replace: MayReplace) -> list[Path]:
    """Write each table as NAME.csv, with all digits, and NAME.tex, rounded to what is known; returns the files.

    Raises:
        InputRefused: a file would be overwritten that may not be, or the folder cannot be written to.
        DiskFull: the disk is full.
    """
    written = []
    with staged_outputs(folder, may_replace) as staged:
        for table in tables:
            with (staged / f"{table.name}.csv").open("w", encoding="utf-8", newline="") as file:
                rows = csv.writer(file, lineterminator="\n")
                rows.writerow(csv_header(table))
                rows.writerows(csv_cells(row) for row in table.rows)
            (staged / f"{table.name}.tex").write_text(table_as_latex(table), encoding="utf-8")
            written += [folder / f"{table.name}.csv", folder / f"{table.name}.tex"]
    return written
