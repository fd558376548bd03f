"""NPY and NPZ: numpy's files are read, what claims more than it has is refused."""

from __future__ import annotations

import io
import struct
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sfr_loc_map.io.array_file import parse_npy, parse_npz

numbers = st.one_of(hnp.boolean_dtypes(), hnp.integer_dtypes(endianness="?"), hnp.floating_dtypes(endianness="?"))


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def with_header(header: str, body: bytes = bytes(100), version: int = 1) -> bytes:
    length = struct.pack("<H" if version == 1 else "<I", len(header))
    return b"\x93NUMPY" + bytes([version, 0]) + length + header.encode("latin-1") + body


@given(hnp.arrays(numbers, hnp.array_shapes(min_dims=0, max_dims=3, max_side=5, min_side=0)), st.booleans())
def test_numpys_files_are_read(array: np.ndarray, fortran: bool) -> None:
    array = np.asfortranarray(array) if fortran else array
    found = parse_npy(npy(array))
    assert found.dtype == array.dtype
    np.testing.assert_array_equal(found, array)
    assert found.flags.writeable


HEADERS = (
    "{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000000, 3), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 3), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (1.0, 3), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
    "{'descr': '<c16', 'fortran_order': False, 'shape': (1,), }",
    "{'descr': '<U99999999', 'fortran_order': False, 'shape': (1,), }",
    "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1,), }",
    *("{'descr': '<f8', 'shape': (", "(" * 1000, "-" * 1000 + "1", "7", " " * 5000, ""),
)


@pytest.mark.parametrize("header", HEADERS)
@pytest.mark.parametrize("version", [1, 2])
def test_broken_headers_are_refused(header: str, version: int) -> None:
    with pytest.raises(ValueError, match=r"it|its"):
        parse_npy(with_header(header, version=version))


def test_cut_files_are_refused() -> None:
    data = npy(np.arange(6.0))
    for length in range(len(data)):
        with pytest.raises(ValueError, match=r"it|its"):
            parse_npy(data[:length])


def test_only_named_members_are_read() -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x.npy", npy(np.arange(3.0)))
        archive.writestr("unused.npy", "not an array")
        archive.writestr("y.npy", npy(np.arange(3, dtype=np.uint8)))
    found = parse_npz(stream.getvalue(), ("x", "y", "z"))
    assert list(found) == ["x", "y"]
    assert found["x"].tolist() == [0.0, 1.0, 2.0]


def test_a_member_that_unpacks_to_far_more_is_refused() -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x.npy", npy(np.zeros(3_000_000)))
    with pytest.raises(ValueError, match="claim to unpack to 24000128"):
        parse_npz(stream.getvalue(), ("x",))
