"""Read verdict and main figures from the head of a report, for `split info`."""

from html.parser import HTMLParser
from pathlib import Path

from split_cli.errors import SplitError, printable, reason_of
from split_cli.files import DIGESTS

KINDS = {
    "split evaluate": "evaluation",
    "split diagnose": "diagnosis",
    "split compare": "comparison",
    "split race": "race",
    "split ingest": "report of a drive",
}
"""Kind of report by the command in its head."""
Facts = tuple[tuple[str, str], ...]
_SHOWN_FILES = 6


class _Head(HTMLParser):
    """Parser of a report's head: command, inputs, verdict and main figures."""

    def __init__(self) -> None:
        super().__init__()
        self.texts = {"command": "", "of": "", "verdict": ""}
        self.facts: list[list[str]] = []
        self._into = ""
        self._in_head = self._in_facts = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self._in_head = self._in_head or tag == "header"
        self._in_facts = self._in_facts or (tag == "dl" and named.get("class") == "facts")
        if tag == "b" and self._in_head:
            self._into = "command"
        elif tag == "span" and self._in_head:
            self._into = "" if named.get("class") == "made" else "of"
        elif tag == "h1" and named.get("id") == "verdict":
            self._into = "verdict"
        elif tag == "dt" and self._in_facts:
            self.facts.append(["", ""])
        elif tag == "small" and self._in_facts and self.facts:
            self.facts[-1][1] += "; "

    def handle_endtag(self, tag: str) -> None:
        self._in_head = self._in_head and tag != "header"
        self._in_facts = self._in_facts and tag != "dl"
        if tag in ("b", "span", "h1"):
            self._into = ""
        elif tag == "dt" and self.facts:
            self._into = "value"
        elif tag == "dd":
            self._into = ""

    def handle_data(self, data: str) -> None:
        if self._into in self.texts:
            self.texts[self._into] += data
        elif self._in_facts and self.facts:
            self.facts[-1][1 if self._into == "value" else 0] += data


def describe_page(page: Path) -> tuple[str, Facts]:
    """Return what a page is, and what it says first: verdict, what was read, main figures.

    Raises
    ------
    SplitError
        If it cannot be read, or no command of this program wrote it.
    """
    head = _Head()
    try:
        # Without the numbers and scripts, which are nearly all of it.
        head.feed(page.read_text(encoding="utf-8").partition("</section>")[0])
    except (OSError, ValueError) as error:
        raise SplitError(f"cannot be read ({reason_of(error)})", where=str(page), advice="Make it anew.") from error
    kind = KINDS.get(head.texts["command"].strip())
    if kind is None:
        raise SplitError("is a page that this program did not write", where=str(page), advice="Name another file.")
    said = [("verdict", head.texts["verdict"]), ("of", head.texts["of"]), *((name, text) for name, text in head.facts)]
    facts = ((name.strip(), " ".join(text.split())) for name, text in said)
    return kind, tuple((printable(name), printable(text)) for name, text in facts if text)


def describe_folder(folder: Path) -> tuple[str, Facts]:
    """Return what a folder with a page is, what the page says first, and what to do with the folder."""
    page = folder / "report.html"
    kind, facts = describe_page(page)
    names = sorted(p.name + "/" * p.is_dir() for p in folder.iterdir() if p.name not in (page.name, DIGESTS))
    pictures = [name for name in names if name.endswith(".png")]
    shown = [printable(name) for name in names if name not in pictures]
    more = f" and {len(shown) - _SHOWN_FILES} more" if len(shown) > _SHOWN_FILES else ""
    beside = [", ".join(shown[:_SHOWN_FILES]) + more] if shown else []
    beside += [f"{len(pictures)} figures (PNG)"] if pictures else []
    content = (("beside it", "; ".join(beside)),) if beside else ()
    last = ("page", f"{page}: open it in a browser"), *content, ("to check it", f"split verify {folder}")
    return kind, (*facts, *last)
