"""What libraries of others may do in the process of their own, for `test_readers_apart`; it imports little."""

import os

import numpy as np

from split_cli.logs.raw import ReadNote
from split_cli.logs.readers.apart import ColumnApart, TableApart, write_table


def two_clocks(path, folder):
    slow, fast = np.arange(5) / 10.0, np.arange(9) / 100.0
    columns = [
        ColumnApart("Speed", "km/h", slow, np.arange(5, dtype="i2")),
        ColumnApart("Gear", "", slow, np.ones(5, dtype="?")),
        ColumnApart("Speed", "", fast, np.arange(9, dtype="f4")),
        ColumnApart("loose", "", None, np.arange(3)),
    ]
    print("what a library prints belongs to nobody")
    write_table(path, folder, lambda path: TableApart(columns, [ReadNote("odd", path.name, 7)]))


def failing(path, folder):
    write_table(path, folder, lambda path: {}["key \x1b[31m"])


def dying(path, folder):
    os.abort()


def greedy(path, folder):
    write_table(path, folder, lambda path: TableApart([ColumnApart("x", "", None, np.ones(1 << 28))]))


def silent(path, folder):
    return None


def wide(path, folder):
    columns = [ColumnApart(f"c{k}", "", None, np.ones(1)) for k in range(20_001)]
    write_table(path, folder, lambda path: TableApart(columns))


def empty(path, folder):
    write_table(path, folder, lambda path: TableApart([ColumnApart("x", "", None, np.ones(0))]))
