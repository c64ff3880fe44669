"""What an extra brings is asked for where it is used, and the error names the extra."""

import sys

import pytest

from split_cli import api
from split_cli.errors import SplitError
from split_cli.logs.readers import open_recording
from split_cli.workflows.engine import open_engine
from split_cli.workflows.sources import find_sources
from tests.optional import needed


def by_dask(folder):
    with open_engine("dask"):
        pass


def by_database(folder):
    (folder / "car.dbc").write_text('VERSION ""\n')
    (folder / "bus.log").write_text("(1700000000.000000) can0 100#0011223344556677\n" * 9)
    open_recording(folder / "bus.log", message_paths=[folder / "car.dbc"])


@pytest.mark.parametrize(
    ("modules", "extra", "use"),
    [
        (("distributed",), "cluster", by_dask),
        (("fsspec",), "cluster", lambda folder: find_sources(["s3://bucket/lap.csv"])),
        (("can",), "can", by_database),
        (("cantools",), "can", by_database),
        (("pandas",), "notebook", lambda folder: api._frame({"t": [0.0]})),
    ],
    ids=["dask", "fsspec", "python-can", "cantools", "pandas"],
)
def test_a_missing_module_names_the_extra_that_brings_it(tmp_path, monkeypatch, modules, extra, use):
    if modules == ("can",):
        needed("cantools")
    for module in modules:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(SplitError) as told:
        use(tmp_path)
    assert f"pip install 'split-cli[{extra}]'" in str(told.value)
