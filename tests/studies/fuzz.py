"""Mutate valid files of every kind: a reader answers with a result or a clear error, soon and in little memory.

Example: ``python -m tests.studies.fuzz --inputs 20000 --seed 1``. Prints, for each kind of file, how many inputs
were read, read with counted drops, and refused, and each that broke a rule; exits with 1 if there is any.
"""

from __future__ import annotations

import argparse
import copy
import gzip
import json
import multiprocessing
import os
import random
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path

from split_cli.errors import SplitError
from tests.studies.fuzz_seeds import NEWER, QUICK, SLOW, seeds

LONGEST_SECONDS = 10.0
"""Of one input, of processor time [s]: the bound the project promises. A starved process is not slow."""
LONGEST_WAIT = 12.0
"""Over that, of the clock on the wall [1]: what waits, or works in another process, may not do so for ever."""
MOST_MEMORY = 1 << 30
"""Resident, of the whole process [bytes]: the bound the project promises."""


@dataclass
class FuzzTally:
    """What became of the inputs of one kind."""

    read: int = 0
    dropped: int = 0
    refused: int = 0
    broken: list[str] = field(default_factory=list)
    slowest: float = 0.0
    grown: int = 0  # by which one input raised the peak memory of its process, at most [bytes]

    def add(self, one: FuzzTally) -> None:
        """Take in what became of more inputs."""
        self.read += one.read
        self.dropped += one.dropped
        self.refused += one.refused
        self.slowest = max(self.slowest, one.slowest)
        self.grown = max(self.grown, one.grown)


class TooLong(BaseException):
    """Raised by the alarm; no reader may catch it."""


_EXTREMES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**64 - 1)
_WORDS = (
    b"",
    b"nan",
    b"inf",
    b"-1e999",
    b"1e308",
    b"9" * 400,
    b"\0",
    b"\xff\xfe",
    b"\x1b[31m",
    b"[" * 300,
    b"{{{{",
    b"&a *a",
    b"../../etc",
    b"'",
    b'"',
    b"\r",
    b"%s",
    b"2023-02-31",
    "ü".encode("utf-16"),
    b"1_000",
    b"!!python/object:os.system",
)


def mutate(content: bytes, other: bytes, rng: random.Random) -> bytes:
    """Return content with one to four mutations that respect fields: bits, integers, words, blocks, ends."""
    out = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        at, kind = rng.randrange(len(out) + 1), rng.randrange(8)
        if kind == 0 and out:
            out[at % len(out)] ^= 1 << rng.randrange(8)
        elif kind == 1:
            size = rng.choice((1, 2, 4, 8))
            value = rng.choice(_EXTREMES) & (256**size - 1)
            out[at : at + size] = value.to_bytes(size, rng.choice(("little", "big")))
        elif kind == 2:
            del out[at:]
        elif kind == 3:
            del out[at : at + rng.choice((1, 4, 16, 100))]
        elif kind == 4:
            out[at:at] = out[at : at + rng.choice((1, 8, 64, 500))]
        elif kind == 5:
            out[at : at + rng.choice((0, 1, 8))] = rng.choice(_WORDS)
        elif kind == 6 and other:
            begin = rng.randrange(len(other))
            out[at : at + 32] = other[begin : begin + rng.choice((8, 64, 400))]
        elif kind == 7 and at + 8 <= len(out):
            number = struct.unpack_from("<d", out, at)[0]
            number = rng.choice((float("nan"), float("inf"), -number, number * 1e300 or 1e300))
            struct.pack_into("<d", out, at, number)
    return bytes(out)


_VALUES = (
    None,
    True,
    -1,
    0,
    10**30,
    10**400,
    1e308,
    -1e308,
    float("nan"),
    float("inf"),
    "",
    "nan",
    "\x1b[31m\u202e",
    "x" * 9999,
    "../../etc/passwd",
    [],
    {},
    [[]],
    {"x": None},
    [1e308] * 999,
)


def mutate_json(content: bytes, rng: random.Random) -> bytes:
    """Return JSON with one to four of its values exchanged for others, moved, repeated, renamed or left out."""
    tree = json.loads(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        found = list(places(tree))
        if not found:
            break
        (parent, key), (other, elsewhere) = rng.choice(found), rng.choice(found)
        kind = rng.randrange(5)
        if kind == 0:
            del parent[key]
        elif kind == 1:
            parent[key] = copy.deepcopy(other[elsewhere])
        elif kind == 2 and isinstance(parent, dict):
            parent[rng.choice(("", "x", str(elsewhere)))] = parent.pop(key)
        elif kind == 3 and isinstance(parent, list):
            parent[key:key] = parent * rng.choice((1, 30))
        else:
            parent[key] = copy.deepcopy(rng.choice(_VALUES))
    return json.dumps(tree).encode()


def places(tree: object) -> Iterator[tuple[dict | list, str | int]]:
    """Yield every value of a tree as its container and its key there."""
    keys = tree if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in keys:
        yield tree, key
        yield from places(tree[key])


def mutant(path: Path, content: bytes, others: list[bytes], rng: random.Random) -> bytes:
    """Return a mutant of a file: of its bytes, of a JSON document in three of four cases of its values."""
    other = rng.choice(others)
    if path.suffix == ".json" and rng.random() < 0.75:
        with suppress(ValueError):  # a document a line
            return mutate_json(content, rng)
    return mutate(content, other, rng)


def judge(path: Path, read: Callable[[Path], object], tally: FuzzTally) -> str | None:
    """Read one input; count it, or return which rule it broke."""

    def ring(*_: object) -> None:
        raise TooLong

    for alarm in (signal.SIGALRM, signal.SIGPROF):
        signal.signal(alarm, ring)
    signal.setitimer(signal.ITIMER_PROF, LONGEST_SECONDS)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_WAIT * LONGEST_SECONDS)
    begin, unheard = time.process_time(), []
    # What fails in a callback of a library is printed with its traceback, and the reader goes on.
    sys.unraisablehook = lambda raised: unheard.append(f"printed {raised.exc_type.__name__}: {raised.exc_value}")
    try:
        dropped = read(path)
        tally.dropped += bool(dropped)
        tally.read += not dropped
    except SplitError as error:
        tally.refused += 1
        text = str(error)
        if not text.isprintable() or "needs more memory" in text or len(text) > 2000:
            return f"unfit message {text[:200]!r}"
    except TooLong:
        return f"over {LONGEST_SECONDS:g} s"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:200]}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        tally.slowest = max(tally.slowest, time.process_time() - begin)
    return unheard[0][:200] if unheard else None


def fuzz(
    inputs: int,
    seed: int,
    keep: Path | None = None,
    only: str = "",
    tell: Callable[[str, FuzzTally], None] = lambda kind, tally: None,
    shares: Mapping[str, float] = SLOW,
    rest: float = 1.0,
) -> dict[str, FuzzTally]:
    """Try `inputs` mutated files, spread over all kinds by their shares, `rest` for those that have none.

    Inputs that break a rule are kept in `keep`. Every kind gets one input at least.
    """
    tallies: dict[str, FuzzTally] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kinds = {kind: what for kind, what in seeds(folder).items() if only in kind}
        others = [path.read_bytes() for path, _ in kinds.values()]
        for kind, (path, read) in kinds.items():
            tally = tallies[kind] = FuzzTally()
            content = path.read_bytes()
            scratch = folder / "scratch"
            work = partial(_try_inputs, f"{seed} {kind}", content, others, path, read, scratch)
            number = 0
            count = max(round(inputs * shares.get(kind, rest) / sum(shares.get(k, rest) for k in kinds)), 1)
            while number < count:
                for at, broken, one in _in_a_process(work, number, min(number + _INPUTS_OF_A_PROCESS, count)):
                    number = at + 1
                    tally.add(one)
                    if broken is None:
                        continue
                    tally.broken.append(f"{kind} {seed}/{at}: {broken}")
                    if keep:
                        keep.mkdir(parents=True, exist_ok=True)
                        name = f"{kind.replace(', ', '_').replace(' ', '_')}-{seed}-{at}{path.suffix}.gz"
                        rng = random.Random(f"{seed} {kind} {at}")
                        (keep / name).write_bytes(gzip.compress(mutant(path, content, others, rng)))
                # What a reader that was killed left in the folder for temporary files.
                shutil.rmtree(scratch, ignore_errors=True)
            # Mutants stand in the file's own place: some are read with what lies beside them.
            path.write_bytes(content)
            tell(kind, tally)
    return tallies


_INPUTS_OF_A_PROCESS = 500


def _try_inputs(
    seed: str,
    content: bytes,
    others: list[bytes],
    target: Path,
    read: Callable,
    scratch: Path,
    first: int,
    last: int,
    said: Connection,
) -> None:
    """Try inputs one by one, in a process of its own; tell of each before and after it is tried."""
    scratch.mkdir(exist_ok=True)
    os.environ["TMPDIR"] = tempfile.tempdir = str(scratch)
    start = _peak()  # of whoever began this process, too: a test run may have had more than what is promised
    for number in range(first, last):
        rng = random.Random(f"{seed} {number}")
        target.write_bytes(mutant(target, content, others, rng))
        said.send(("begin", number, None))
        one, before = FuzzTally(), _peak()
        broken, peak = judge(target, read, one), _peak()
        # A peak never falls: what an input adds to that of all before it is the input's own.
        one.grown = peak - before
        if broken is None and one.grown and peak - start > MOST_MEMORY:
            broken = f"memory: {(peak - start) / 1e6:.0f} MB, {one.grown / 1e6:.0f} MB more than any input before"
        said.send(("end", broken, one))


def _peak() -> int:
    """Return the largest resident memory that this process has had [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _in_a_process(work: Callable, first: int, last: int) -> Iterator[tuple[int, str | None, FuzzTally]]:
    """Yield number, broken rule and tally of each input; a process that dies has broken a rule at its input."""
    context = multiprocessing.get_context("fork")
    hears, says = context.Pipe(duplex=False)
    process = context.Process(target=work, args=(first, last, says))
    process.start()
    says.close()
    number, ended, begun = first, True, False
    try:
        while True:
            kind, value, one = hears.recv()
            if kind == "begin":
                number, ended, begun = value, False, True
            else:
                ended = True
                yield number, value, one
    except EOFError:
        process.join()
        if not begun:
            raise RuntimeError("no input could be made; the process has printed why") from None
        if not ended:
            yield number, f"the process died (exit code {process.exitcode})", FuzzTally()


def _print_row(kind: str, tally: FuzzTally) -> None:
    count = tally.read + tally.dropped + tally.refused
    row = f"{kind:18} {count:8} {tally.read:8} {tally.dropped:8} {tally.refused:8}"
    print(f"{row} {len(tally.broken):7} {tally.slowest:9.2f} {tally.grown / 1e6:9.0f}", flush=True)


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for inputs that broke a rule")
    parser.add_argument("--only", default="", help="kinds whose name holds this")
    parser.add_argument("--quick", action="store_true", help="most inputs of the kinds that are read quickly")
    parser.add_argument("--newer", action="store_true", help="inputs of the kinds that came last")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    begin = time.perf_counter()
    if not given.json:
        counts = f"{'kind':18} {'inputs':>8} {'read':>8} {'drops':>8} {'refused':>8}"
        print(f"{counts} {'broken':>7} {'slowest s':>9} {'most MB':>9}")
    tell = (lambda *_: None) if given.json else _print_row
    shares, rest = (SLOW | QUICK if given.quick else SLOW), 1.0
    if given.newer:
        shares, rest = dict.fromkeys(NEWER, 1.0), 1e-9
    tallies = fuzz(given.inputs, given.seed, given.keep, given.only, tell, shares, rest)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024
    broken = [line for tally in tallies.values() for line in tally.broken]
    if peak > MOST_MEMORY:
        broken.append(f"memory: {peak / 1e6:.0f} MB, {MOST_MEMORY / 1e6:.0f} MB are promised")
    if given.json:
        print(json.dumps({kind: vars(tally) for kind, tally in tallies.items()}, indent=1))
    else:
        whole = sum(t.read + t.dropped + t.refused for t in tallies.values())
        print(f"{whole} inputs kept the rules, {sum(len(t.broken) for t in tallies.values())} broke one")
        print(f"{time.perf_counter() - begin:.0f} s, peak memory {peak / 1e6:.0f} MB")
    for kinds, count in Counter(line.split(":", 1)[1].split("(")[0][:90] for line in broken).most_common(20):
        print(f"broken {count} x {kinds}", file=sys.stderr)
    for line in broken[:40]:
        print(line, file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
