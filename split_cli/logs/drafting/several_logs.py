"""One map for several logs of one car: the draft that is judged best, filled and compared with the others."""

from collections.abc import Collection, Mapping
from dataclasses import replace

from split_cli.logs.drafting.draft import Draft, Suggestion

_WEIGHT = {"judged": 4, "unsided": 3, "stated": 2, "assumed": 1, "open": 0}
"""How much is known of a channel, by its status [1]; only the order of logs follows from it."""
_BY_A_CHECK = ("judged", "unsided")


def agreed_draft(drafts: Mapping[str, Draft], recorded: Mapping[str, Collection[str]]) -> tuple[Draft, tuple[str, ...]]:
    """Return one draft for several logs, and what a user has to know of logs that differ.

    Parameters
    ----------
    drafts : mapping of str to Draft
        The draft of each log alone, by the log's name.
    recorded : mapping of str to collection of str
        The names of the signals of each log.

    Notes
    -----
    A log in which the car hardly moves judges little. So the draft of which most is judged is taken whole. What it
    leaves open is taken from the others. A channel that two logs judge in different ways is marked. Of a steering that
    all leave open, that log is believed in which understeer adds least.
    """
    best = max(drafts, key=lambda name: sum(_WEIGHT[s.status] for s in drafts[name].suggestions))
    draft, others = drafts[best], {name: other for name, other in drafts.items() if name != best}
    mapped = {s.channel for s in draft.suggestions if s.status != "open"}
    added = _of_others(draft, others, mapped)
    kept = [_of_least_understeer(s, others) for s in draft.suggestions if s.channel not in added]
    whole = [_compared(s, best, others) if s.channel in mapped else s for s in (*kept, *added.values())]
    named = [(f"{s.channel} ({source})", source) for s in whole if s.status != "open" for source in s.sources]
    notes = []
    for name in drafts:
        absent = [shown for shown, source in named if not any(_is_of(source, have) for have in recorded[name])]
        if absent:
            notes.append(f"{name} does not hold {', '.join(absent)}.")
    notes += [f"Logs differ on {s.channel}: {s.reason.split('; ')[0]}." for s in whole if " judges it by " in s.reason]
    undefined = tuple(dict.fromkeys(kind for one in drafts.values() for kind in one.undefined))
    return replace(draft, suggestions=tuple(whole), undefined=undefined), tuple(notes)


def _of_others(draft: Draft, others: Mapping[str, Draft], mapped: Collection[str]) -> dict[str, Suggestion]:
    """Return the channels that a draft leaves open and another log maps, each by the first that does."""
    taken = {source for s in draft.suggestions if s.status != "open" for source in s.sources}
    added: dict[str, Suggestion] = {}
    for name, other in others.items():
        for s in other.suggestions:
            is_new = s.status not in ("open", "assumed") and s.channel not in {*mapped, *added}
            if is_new and not taken & set(s.sources):
                added[s.channel] = replace(s, reason=f"{s.reason}; by {name}")
    return added


def _of_least_understeer(s: Suggestion, others: Mapping[str, Draft]) -> Suggestion:
    """Return an open steering signal with what that log says of it whose angle over curvature is the smallest.

    Understeer adds to a wheelbase times a ratio: on a log at the limit of grip it made 30 of a ratio of 16.
    """
    if s.status != "open":
        return s
    same = [(name, one) for name, other in others.items() for one in other.all_of(s.channel)]
    open_there = [(one.reach, name, one) for name, one in same if one.status == "open" and one.sources == s.sources]
    known = [(reach, name, one) for reach, name, one in open_there if reach is not None]
    if not known:
        return s
    least, name, one = min(known, key=lambda each: each[:2])
    return s if s.reach is not None and s.reach <= least else replace(one, reason=f"{one.reason}; by {name}")


def _is_of(source: str, recorded: str) -> bool:
    """Whether a signal is a source of a map; a quaternion stands there by the name of its message's field."""
    rest = recorded.removeprefix(source)
    return recorded.startswith(source) and (not rest or source.endswith(":") or rest[0] in "./")


def _compared(s: Suggestion, log: str, others: Mapping[str, Draft]) -> Suggestion:
    """Return a channel as the first log that judges it has it, marked where another judges it otherwise.

    Another signal of the same quantity may be as good; the same one in another unit is not.
    """
    by = log
    for name, other in others.items():
        theirs = other.of(s.channel)
        if theirs is None or theirs.sources != s.sources or theirs.status not in _BY_A_CHECK:
            continue
        if s.status not in _BY_A_CHECK:
            s, by = replace(theirs, reason=f"{theirs.reason}; by {name}"), name
        elif _reading(theirs) != _reading(s):
            ways = f"{by} judges it by {_in_words(s)}, {name} by {_in_words(theirs)}"
            return replace(s, status="assumed", reason=f"{ways}; {s.reason}")
    return s


def _reading(s: Suggestion) -> tuple:
    """Return what makes a channel of its signals; a scale counts by its first digit."""
    return (s.unit, s.convert, s.world, f"{s.scale:.1g}")


def _in_words(s: Suggestion) -> str:
    scale = f" times {s.scale:g}" if s.scale != 1.0 else ""
    return f"{', '.join(s.sources)}{f' in {s.unit}' if s.unit else ''}{scale}"
