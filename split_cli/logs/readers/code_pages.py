"""The encoding of a text that states none, by its bytes."""

import codecs
import re

MARKS = ((codecs.BOM_UTF8, "utf-8"), (codecs.BOM_UTF16_LE, "utf-16-le"), (codecs.BOM_UTF16_BE, "utf-16-be"))
"""Marks at the beginning of a file that state its encoding."""


def utf_16_without_mark(head: bytes) -> str:
    """Return the encoding of a text in UTF-16 whose mark is missing, by its zero bytes; empty of any other."""
    pairs = head[: len(head) // 2 * 2]
    for first, encoding in ((0, "utf-16-be"), (1, "utf-16-le")):
        zeros, others = pairs[first::2], pairs[1 - first :: 2]
        if len(zeros) > 20 and zeros.count(0) > 0.9 * len(zeros) and others.count(0) == 0:
            return encoding
    return ""


def decoded(line: bytes) -> str:
    """Return a line; one that is no UTF-8 is Western European."""
    try:
        return line.decode()
    except UnicodeDecodeError:
        return line.decode("cp1252", errors="replace")


_KANA = re.compile(rb"\x83[\x40-\x96]|\x82[\x9f-\xf1]")
"""Syllables of Japanese in its code page; Western texts hardly have the bytes that they begin with."""
_CYRILLIC_WORD = re.compile(rb"[\xa8\xc0-\xff][\xb8\xe0-\xff]{3,}")
"""Four letters or more, all but the first small: in Western code pages not so many accents stand together."""
_FEWEST_LETTERS = 2


def _by_letters(sample: bytes) -> list[str]:
    """Return the code page of Japanese or of Russian where its letters show."""
    if len(_KANA.findall(sample)) >= _FEWEST_LETTERS:
        return ["cp932"]
    return ["cp1251"] if len(_CYRILLIC_WORD.findall(sample)) >= _FEWEST_LETTERS else []


#: A pair of bytes that is one of the 3,755 common characters of GB 2312, in a run of such pairs.
_COMMON = re.compile(rb"(?<![\x80-\xff])(?:[\x80-\xff]{2})*?[\xb0-\xd7][\xa1-\xfe]")


def encoding_of(sample: bytes) -> str:
    """Return UTF-8, the Japanese, Russian or Chinese code page, or that of Western Europe.

    In Chinese text the bytes beyond ASCII come in pairs (or in fours, with digits between), some of them common
    characters. Umlauts stand alone; where two stand together (Größe) they would be a rare character.
    """
    if sample.isascii():
        return "utf-8"
    for encoding in ("utf-8", *_by_letters(sample), "gb18030"):
        try:
            codecs.getincrementaldecoder(encoding)().decode(sample, final=False)
        except UnicodeDecodeError:
            continue
        runs = re.findall(rb"[\x80-\xff]+", re.sub(rb"[\x81-\xfe][0-9][\x81-\xfe][0-9]", b"", sample))
        if encoding != "gb18030" or (all(len(run) % 2 == 0 for run in runs) and _COMMON.search(b" ".join(runs))):
            return encoding
    return "latin-1"
