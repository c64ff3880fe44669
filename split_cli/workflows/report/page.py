"""Put the report together: one page with its style, its script and its numbers inside."""

from __future__ import annotations

import base64
import hashlib
from importlib.resources import files
from string import Template

from split_cli import __version__
from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.workflows.report.payload import chart_numbers, embedded_json
from split_cli.workflows.report.sections import all_sections, headline
from split_cli.workflows.report.words import escape

__all__ = ["report_page"]


def report_page(diagnosis: Diagnosis) -> str:
    """Return the report of a diagnosis as one HTML document that loads nothing.

    Notes
    -----
    Names of files are text of whoever made the files. They are escaped wherever they stand, and a content security
    policy admits only the script whose hash it names, so that a name that slipped through could not run.
    """
    package = files("split_cli.workflows.report")

    def part(name: str) -> str:
        return package.joinpath(name).read_text(encoding="utf-8")

    script = f"{part('charts.js')}\n{part('report.js')}"
    digest = base64.b64encode(hashlib.sha256(script.encode("utf-8")).digest()).decode("ascii")
    real = ", ".join(one.name for one in diagnosis.inputs if one.role == "real")
    return Template(part("report.html")).substitute(
        title=escape(f"{headline(diagnosis)} {real}".strip()),
        version=escape(__version__),
        names=escape(_compared(diagnosis)),
        digest=digest,
        style=part("report.css"),
        body=all_sections(diagnosis),
        numbers=embedded_json(chart_numbers(diagnosis)),
        script=script,
    )


def _compared(diagnosis: Diagnosis) -> str:
    by_role = {
        role: [one.name for one in diagnosis.inputs if one.role == role] for role in ("real", "sim", "vehicle")
    }
    simulation = (
        ", ".join(by_role["sim"]) or f"the nominal model of {', '.join(by_role['vehicle']) or 'the vehicle'}"
    )
    return f"{', '.join(by_role['real']) or 'the real drive'} against {simulation}"
