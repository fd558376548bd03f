"""Facts of the sources, kept in the cache of a suite because the hash of a large source takes minutes."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from sfr_loc_map.atomic import write_text
from sfr_loc_map.errors import InputError
from sfr_loc_map.inputs import MAX_JSON_BYTES, read_text, refusing
from sfr_loc_map.json_yaml import parse_json
from sfr_loc_map.metrics.stored.score_json import from_plain, json_line, to_plain
from sfr_loc_map.suite.running.digests import code_fingerprint, file_state, files_of_source
from sfr_loc_map.suite.running.job import digest
from sfr_loc_map.suite.running.source_readers import SourceFacts, inspect_file

FACTS = "facts"  #: Folder in the cache, with one file for each source.


class FactsCache:
    """The facts of sources in the cache of a suite.

    The facts of a source are valid until the code or the `file_state` of one of its files changes. An unreadable file
    of the cache is written again.
    """

    def __init__(self, cache: Path) -> None:
        self._folder = cache / FACTS

    def facts_of(self, path: Path) -> SourceFacts:
        """Return the facts of a source; InputError if the source cannot be read."""
        state = digest([code_fingerprint(), *(file_state(file) for file in files_of_source(path))])
        file = self._folder / f"{digest(str(path.absolute()))}.json"
        with suppress(InputError):
            return _read_facts(file, state)
        facts = inspect_file(path)
        self._folder.mkdir(parents=True, exist_ok=True)
        write_text(json_line({"source": str(path.absolute()), "state": state, "facts": to_plain(facts)}), file)
        return facts


def _read_facts(file: Path, state: str) -> SourceFacts:
    """Return the facts in a file of the cache; InputError if there are none for this state of the source."""
    with refusing(f"cannot read '{file}'"):
        content = parse_json(read_text(file, MAX_JSON_BYTES))
        if content["state"] != state:
            raise ValueError("it has facts of another state of the source")
        return from_plain(SourceFacts, content["facts"])
