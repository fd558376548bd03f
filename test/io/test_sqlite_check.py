"""A database that was cut off is told by its size, whatever the version of the library makes of it."""

import sqlite3
from pathlib import Path

import pytest

from sfr_loc_map.errors import InputError
from sfr_loc_map.io.bag_files import check_database as check_whole


@pytest.fixture
def database(tmp_path: Path) -> Path:
    path = tmp_path / "x.db3"
    with sqlite3.connect(path) as connection:
        connection.execute("create table messages (data blob)")
        connection.executemany("insert into messages values (?)", [(bytes(3000),)] * 20)
    connection.close()
    return path


def test_a_whole_file_passes(database: Path) -> None:
    check_whole(database)


@pytest.mark.parametrize("missing", [1, 4096, 30000])
def test_a_file_that_lacks_its_end_is_named(database: Path, missing: int) -> None:
    whole = database.read_bytes()
    database.write_bytes(whole[:-missing])
    with pytest.raises(InputError, match=f"{len(whole) - missing} of {len(whole)} bytes"):
        check_whole(database)


def test_other_files_are_left_to_the_library(tmp_path: Path) -> None:
    for content in (b"", b"no database", bytes(200)):
        (tmp_path / "x.db3").write_bytes(content)
        check_whole(tmp_path / "x.db3")
