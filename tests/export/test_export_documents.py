"""npz and json: read by the twenty lines the documentation prints, and by a JSON schema validator."""

import json
import re
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from split_cli.errors import ExportError
from split_cli.export.documents import (
    document_of,
    read_json,
    read_npz,
    require_equal,
    schema_text,
    write_json,
    write_npz,
)
from split_cli.export.provenance import provenance_of

DOCS = Path(__file__).resolve().parents[2] / "docs" / "export.md"


def printed_reader():
    """Return the reader of docs/export.md, run as it is printed."""
    code = re.search(r"```python\n# reader\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)[1]
    assert len(code.strip().splitlines()) <= 25
    namespace: dict = {}
    exec(code, namespace)
    return namespace["load"], namespace["predict"]


@pytest.fixture
def written(small_set, tmp_path):
    document = document_of(small_set, provenance_of(small_set, "bcm", "car.split", "a" * 64))
    write_npz(document, tmp_path / "car.npz")
    write_json(document, tmp_path / "car.json")
    return document, tmp_path


@pytest.mark.parametrize("kind", ["npz", "json"])
def test_the_printed_reader_reproduces_the_predictions(written, small_oracle, kind):
    load, predict = printed_reader()
    arrays = load(str(written[1] / f"car.{kind}"))
    near = (np.abs(small_oracle.z) < 1e6).all(axis=1)
    mean, variance = predict(arrays, small_oracle.z[near])
    deviation = small_oracle.reference.deviation
    assert np.abs((mean - small_oracle.mean[near]) / deviation).max() <= 1e-12
    assert np.abs((variance - small_oracle.variance[near]) / deviation**2).max() <= 1e-12


def test_both_read_back_bit_for_bit(written):
    document, folder = written
    require_equal(document, read_npz(folder / "car.npz"), "npz")
    require_equal(document, read_json(folder / "car.json"), "json")
    z = document.arrays["z"].copy()
    z[3, 1] = np.nextafter(z[3, 1], 1.0)
    with pytest.raises(ExportError, match="z does not read back"):
        require_equal(replace(document, arrays={**document.arrays, "z": z}), read_json(folder / "car.json"), "json")


def test_the_json_meets_its_schema(written, z1_set):
    schema = json.loads(schema_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    content = json.loads((written[1] / "car.json").read_text())
    jsonschema.validate(content, schema)
    # A grid without bounds writes null, which JSON has, and not Infinity, which it has not.
    unbounded = document_of(z1_set, provenance_of(z1_set, "bcm", "z1.split"))
    write_json(unbounded, written[1] / "z1.json")
    unbounded_content = json.loads((written[1] / "z1.json").read_text(), parse_constant=pytest.fail)
    jsonschema.validate(unbounded_content, schema)
    assert unbounded_content["grid"]["lower"] == [None] * 5
    for key in ("z", "vehicle", "noise_variance"):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({k: v for k, v in content.items() if k != key}, schema)


def test_npz_needs_no_pickle_and_is_the_same_twice(written, tmp_path):
    document, folder = written
    write_npz(document, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (folder / "car.npz").read_bytes()
    with np.load(folder / "car.npz", allow_pickle=False) as content:
        assert json.loads(str(content["metadata"]))["set"]["sha256"] == "a" * 64


@pytest.mark.parametrize("kind", ["npz", "json"])
@pytest.mark.parametrize("damage", ["truncated", "flipped", "empty", "absent"])
def test_damage_is_an_error_that_names_the_file(written, kind, damage):
    path = written[1] / f"car.{kind}"
    content = bytearray(path.read_bytes())
    if damage == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "flipped":
        middle = content.rindex(b"noise_variance") if kind == "json" else len(content) // 2
        content[middle] ^= 0xFF
        path.write_bytes(content)
    elif damage == "empty":
        path.write_bytes(b"")
    else:
        path.unlink()
    with pytest.raises(ExportError, match=f"car.{kind}"):
        (read_npz if kind == "npz" else read_json)(path)
