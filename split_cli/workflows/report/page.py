"""The report of a diagnosis, put together."""

from collections.abc import Sequence
from importlib.resources import files

from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.plots.chart import Chart
from split_cli.workflows.report.payload import chart_numbers
from split_cli.workflows.report.sections import all_sections, diagnosis_headline
from split_cli.workflows.report.shell import page


def report_page(diagnosis: Diagnosis, charts: Sequence[Chart] = ()) -> str:
    """Return the report of a diagnosis as one HTML document that loads nothing; see `shell.page`.

    Parameters
    ----------
    charts : sequence of Chart
        Of the recordings behind it, which a diagnosis does not hold.
    """
    real = ", ".join(one.name for one in diagnosis.inputs if one.role == "real")
    package = files("split_cli.workflows.report")
    return page(
        "diagnose",
        _compared(diagnosis),
        f"{diagnosis_headline(diagnosis)} {real}".strip(),
        all_sections(diagnosis, charts),
        charts,
        chart_numbers(diagnosis),
        [package.joinpath(name).read_text("utf-8") for name in ("where.js", "held_out_errors.js")],
    )


def _compared(diagnosis: Diagnosis) -> str:
    by_role = {role: [one.name for one in diagnosis.inputs if one.role == role] for role in ("real", "sim", "vehicle")}
    simulation = ", ".join(by_role["sim"]) or f"the nominal model of {', '.join(by_role['vehicle']) or 'the vehicle'}"
    return f"{', '.join(by_role['real']) or 'the real drive'} against {simulation}"
