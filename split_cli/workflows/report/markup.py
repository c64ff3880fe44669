"""Pieces of HTML that several sections are made of."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

__all__ = ["bar_row", "section", "table"]


def section(name: str, title: str, body: str) -> str:
    """Return a section of the page under a heading; `title` and `body` are HTML already."""
    return (
        f'<section id="{name}" aria-labelledby="{name}-title"><h2 id="{name}-title">{title}</h2>{body}</section>'
    )


def bar_row(label: str, share: float, value: str) -> str:
    """Return one bar of a bar chart; `label` is HTML already, `share` of the full width [1]."""
    width = min(max(share, 0.0), 1.0) * 100.0
    return (
        f'<div class="bar"><span>{label}</span>'
        f'<span class="track"><span style="width:{width:.1f}%"></span></span><b>{value}</b></div>'
    )


def table(heads: Sequence[str], rows: Iterable[str], kind: str = "") -> str:
    """Return a table that scrolls by itself where the page is narrow; heads and rows are HTML already."""
    columns = "".join(f"<th scope=col>{head}</th>" for head in heads)
    return (
        f'<div class="scroll" tabindex="0"><table class="{kind}"><thead><tr>{columns}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )
