"""How much a compressed or self-describing source may unfold into: bounds that no honest recording reaches."""

from split_cli.errors import LogError

ALWAYS = 64 << 20
"""What any source may unfold into [bytes]; judgement: one chunk of a recorder has 1 to 8 MB."""
_MULTIPLE = 300
"""Bytes out for a byte in [1]; theory: lz4 reaches 255, a column that never changes comes near."""
_AT_MOST = 2 << 30
"""Of one chunk or variable [bytes]; theory: sizes in these formats are 32 bit, and half of that is a sign."""
MOST_OF_A_FILE = 60
"""Bytes out for a byte in, of a whole compressed file or archive [1]; judgement: recordings of a car that stands reach
20, and what is within `ALWAYS` is allowed to any."""
MOST_FIELDS = 20_000
"""Numbers in one message type [1]; judgement: the largest of ROS has some 300, a full lidar's header 2,000."""
LONGEST_NAME = 500
"""Of an address within a message or row [characters]; judgement: the longest of ROS has 100. Each of 20,000 fields
repeats the names above it, and a chunk may unfold into a name of megabytes."""


def most_bytes_out(bytes_in: int) -> int:
    """Return how many bytes `bytes_in` compressed ones may become: at least 64 MB, 300 to one, at most 2 GB."""
    return min(max(ALWAYS, _MULTIPLE * bytes_in), _AT_MOST)


def most_bytes_of_file(bytes_in: int) -> int:
    """Return how many bytes a compressed file or archive of `bytes_in` may become: at least 64 MB, 60 to one."""
    return max(ALWAYS, MOST_OF_A_FILE * bytes_in)


class Unfolded:
    """What the chunks of one file have become so far: each may be a bomb, and all of them together, too.

    Parameters
    ----------
    bytes_in : int
        Of the whole file.

    Attributes
    ----------
    whole : int
        What all may become together [bytes]: at least 64 MB, 300 to one.
    """

    def __init__(self, bytes_in: int) -> None:
        self.whole = max(ALWAYS, _MULTIPLE * bytes_in)
        self._sizes: dict[int, int] = {}
        self._total = 0

    def most(self, chunk: int, bytes_in: int) -> int:
        """Return how many bytes a chunk, known by its first one, may become: `most_bytes_out`, or what is left."""
        left = self.whole - self._total + self._sizes.get(chunk, 0)
        return max(min(most_bytes_out(bytes_in), left), 0)

    def add(self, chunk: int, size: int) -> None:
        """Count what a chunk became."""
        self._total += size - self._sizes.get(chunk, 0)
        self._sizes[chunk] = size


def refuse_many_columns(count: int, where: str) -> None:
    """Refuse a table of more columns than a message may have numbers: each is looked at in many ways.

    Raises
    ------
    LogError
        If there are more than `MOST_FIELDS`.
    """
    if count > MOST_FIELDS:
        advice = "Export the channels that you need."
        raise LogError(f"has more than {MOST_FIELDS:,} columns", where=where, advice=advice)


def refuse_unpacked_size(size: int, bytes_in: int, what: str, where: str, most: int | None = None) -> None:
    """Refuse a size that a file claims for its content before memory is taken for it.

    Raises
    ------
    LogError
        If it is more than `most`, by default `most_bytes_out` of what is stored.
    """
    if size > (most_bytes_out(bytes_in) if most is None else most):
        raise LogError(
            f"{what} claims {size / 1e6:,.0f} MB, stored in {bytes_in / 1e6:.3g} MB: no recording is like that",
            where=where,
            advice="The file is damaged or made to exhaust memory; save it again without compression to read it.",
        )
