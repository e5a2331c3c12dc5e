"""Files of fields."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid
from wavesim.fields.files import read_field, write_field


def some_field(rows: int, columns: int, seed: int = 0) -> Any:
    """Complex values of all phases."""
    rng = np.random.default_rng(seed)
    parts = rng.standard_normal((2, rows, columns)).astype(np.float32)
    return (parts[0] + 1j * parts[1]).astype(np.complex64)


@settings(max_examples=20)
@given(rows=st.integers(1, 20), columns=st.integers(1, 20))
def test_fields_come_back_as_written(
    tmp_path_factory: pytest.TempPathFactory, rows: int, columns: int
) -> None:
    path, values = tmp_path_factory.mktemp("field") / "field.npz", some_field(rows, columns)
    write_field(Field(Grid((rows, columns), 4e-4, 0.0), values, 0.532), path, field_stop_mm=0.1)
    found, pitch_um = read_field(path)
    assert np.array_equal(found, values)
    assert pitch_um == pytest.approx(0.4)


def test_files_that_hold_no_field_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "field.npz"
    good = {"values": np.ones((4, 4), np.complex64), "pitch_um": 0.4}
    for change, words in (
        ({"values": np.ones(4)}, r"shape \(4,\): must be complex or real, \(ny, nx\)"),
        ({"values": np.array([["a"]])}, "must be complex or real"),
        ({"values": np.full((4, 4), np.nan)}, "not finite"),
        ({"pitch_um": 0.0}, "`pitch_um` must be one number"),
        ({"pitch_um": [1.0, 2.0]}, "`pitch_um` must be one number"),
        ({"pitch_um": "wide"}, "`pitch_um` must be one number"),
    ):
        np.savez(path, **{**good, **change})  # type: ignore[arg-type]
        with pytest.raises(InputError, match=rf"field .*field\.npz.*{words}"):
            read_field(path)
    np.savez(path, values=good["values"])  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"pitch_um.*\['values'\]"):
        read_field(path)
    np.savez(path, **good)  # type: ignore[arg-type]
    data = path.read_bytes()
    for cut in (0, 10, len(data) // 2, len(data) - 10):
        path.write_bytes(data[:cut])
        with pytest.raises(InputError, match=r"field .*field\.npz"):
            read_field(path)
    path.write_bytes(data[:70] + bytes(40) + data[110:])
    with pytest.raises(InputError, match=r"field .*field\.npz"):
        read_field(path)
