"""NPY and NPZ: numpy's files are read, what claims more than it has is refused."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sfr_loc_map.io.clouds.array_file import parse_npy, parse_npz

numbers = st.one_of(hnp.boolean_dtypes(), hnp.integer_dtypes(endianness="?"), hnp.floating_dtypes(endianness="?"))


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def npz(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


@given(hnp.arrays(numbers, hnp.array_shapes(min_dims=0, max_dims=3, max_side=5, min_side=0)), st.booleans())
def test_numpys_files_are_read(array: np.ndarray, fortran: bool) -> None:
    array = np.asfortranarray(array) if fortran else array
    found = parse_npy(npy(array))
    assert found.dtype == array.dtype
    np.testing.assert_array_equal(found, array)
    assert found.flags.writeable


FORM = "{{'descr': {}, 'fortran_order': False, 'shape': {}, }}"


@pytest.mark.parametrize(
    "header",
    [
        *(FORM.format("'<f8'", shape) for shape in ("(10000000000000, 3)", "(-1, 3)", "(1.0, 3)")),
        *(FORM.format(kind, "(1,)") for kind in ("'|O'", "'<c16'", "'<U99999999'", "[('a', '<f4')]")),
        *("{'descr': '<f8', 'shape': (", "(" * 1000, "-" * 1000 + "1", "7", " " * 5000, ""),
    ],
)
@pytest.mark.parametrize("version", [1, 2])
def test_broken_headers_are_refused(header: str, version: int) -> None:
    length = struct.pack("<H" if version == 1 else "<I", len(header))
    with pytest.raises(ValueError, match=r"it|its"):
        parse_npy(b"\x93NUMPY" + bytes([version, 0]) + length + header.encode("latin-1") + bytes(100))


def test_cut_files_are_refused() -> None:
    data = npy(np.arange(6.0))
    for length in range(len(data)):
        with pytest.raises(ValueError, match=r"it|its"):
            parse_npy(data[:length])


def test_only_named_members_are_read_and_what_unpacks_to_far_more_is_refused() -> None:
    found = parse_npz(npz(x=np.arange(3.0), unused=np.array(["text"]), y=np.arange(3)), ("x", "y", "z"))
    assert (list(found), found["x"].tolist()) == (["x", "y"], [0.0, 1.0, 2.0])
    with pytest.raises(ValueError, match="declare 24000128 decompressed bytes"):
        parse_npz(npz(x=np.zeros(3_000_000)), ("x",))
