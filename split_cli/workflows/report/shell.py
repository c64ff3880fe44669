"""One page: head, style, scripts and numbers of every report, with a policy that admits nothing else."""

import base64
import hashlib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from string import Template
from typing import Any

from split_cli import __version__
from split_cli.plots.chart import Chart, ChartLine
from split_cli.plots.palette import DARK, LIGHT
from split_cli.workflows.report.payload import embedded_json, packed
from split_cli.workflows.report.words import escape, readable

_NOSCRIPT = "<noscript><p>The charts need scripts, which are part of this file.</p></noscript>"


def page(
    command: str,
    names: str,
    title: str,
    body: str,
    charts: Sequence[Chart] = (),
    numbers: Mapping[str, Any] | None = None,
    scripts: Sequence[str] = (),
) -> str:
    """Return one HTML document that loads nothing.

    Parameters
    ----------
    command : str
        The command that wrote it.
    names : str
        What was read, for the head of the page; text, escaped here.
    title : str
        Of the window; text, escaped here.
    body : str
        HTML.
    charts : sequence of Chart
        Drawn where the body has their figures.
    numbers : mapping, optional
        Further numbers, for `scripts`.
    scripts : sequence of str
        Texts of further scripts, which run before the charts are drawn.

    Notes
    -----
    Names of files are text of whoever made the files. They are escaped wherever they stand, and a content security
    policy admits only the script and the style whose hashes it names, so that a name that slipped through could
    neither run nor change the page.
    """
    package = files("split_cli.workflows.report")

    def part(name: str) -> str:
        return package.joinpath(name).read_text(encoding="utf-8")

    script = "\n".join([part("charts.js"), *scripts, part("views.js")])
    style = f"{_palette()}\n{part('page.css')}"
    content = {**(numbers or {}), "charts": [chart_payload(chart) for chart in charts]}
    return Template(part("page.html")).substitute(
        title=escape(title),
        version=escape(__version__),
        command=escape(command),
        names=escape(names),
        digest=_digest(script),
        style_digest=_digest(style),
        style=style,
        body=body + (_NOSCRIPT if charts or scripts else ""),
        numbers=embedded_json(content),
        script=script,
    )


def chart_payload(chart: Chart) -> dict[str, Any]:
    """Return what the script draws a chart from; names are made readable, and are written as text there."""
    return {
        "name": chart.name,
        "title": readable(chart.title),
        "x": chart.x,
        "y": chart.y,
        "other_x": chart.other_x,
        "rows": [readable(row) for row in chart.rows],
        "equal": chart.equal,
        "wide": chart.wide,
        "group": chart.group,
        "reference": chart.reference,
        "least_span": chart.least_span,
        "bands": [{"low": band.low, "high": band.high, "name": readable(band.name)} for band in chart.bands],
        "series": [_series(one) for one in chart.series],
    }


def _series(one: ChartLine) -> dict[str, Any]:
    fields: dict[str, Any] = {
        "name": readable(one.name),
        "role": one.role,
        "kind": one.kind,
        "shown": one.shown,
        "x": packed(one.x),
        "y": packed(one.y),
        "emphasis": list(one.emphasis),
    }
    for name in ("low", "high", "along"):
        values = getattr(one, name)
        fields[name] = None if values is None else packed(values)
    return fields


def _palette() -> str:
    """Return the colours of series as variables, for both schemes; print is on white paper."""
    light, dark = (" ".join(f"--{role}: {colour};" for role, colour in colours.items()) for colours in (LIGHT, DARK))
    return f":root {{ {light} }}\n@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode("utf-8")).digest()).decode("ascii")
