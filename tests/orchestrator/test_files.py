"""Tables of columns for files."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pyarrow as pa
import pytest

from scancell.files import arrow_table


@pytest.mark.parametrize("dtype", ["u1", "u4", "i4", "i8", "f4", "f8"])
def test_table_equals_that_of_pyarrow(dtype: str) -> None:
    rng = np.random.default_rng(3)
    columns = {name: rng.uniform(0, 200, (50, 2)).astype(dtype) for name in ("a", "b")}
    strided = {name: values[::2, 1] for name, values in columns.items()}
    if dtype.startswith("f"):
        strided["a"][3] = np.nan
    found, expected = arrow_table(strided), pa.table({name: pa.array(values) for name, values in strided.items()})
    assert found.schema == expected.schema
    assert all(np.array_equal(found[name], expected[name], equal_nan=True) for name in strided)
    assert found["a"].null_count == 0
    assert arrow_table({"a": strided["a"][:0]}).num_rows == 0


def test_pandas_is_not_imported() -> None:
    program = (
        "import sys, numpy; from scancell.files import arrow_table; arrow_table({'a': numpy.zeros(3)});"
        " sys.exit('pandas' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
