"""The methods of a benchmark: ours, those of the registry, and what the user adds."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sfr_loc_map.bench.results import OURS
from sfr_loc_map.inputs import Task
from sfr_loc_map.methods.registry import BUILT_IN, PEERS, Method, find_method, find_peer


@dataclass(frozen=True, slots=True)
class Competitors:
    """Methods of a benchmark, ours first.

    Attributes:
        present: Methods that can be run.
        missing: Reason why the others cannot be run, by name.
    """

    present: tuple[Method, ...]
    missing: Mapping[str, str]

    def configured(self, config: Mapping[str, object]) -> tuple[Method, ...]:
        """Return the methods, ours with these parameters."""
        ours, *others = self.present
        return (replace(ours, config=json.dumps(config)), *others)


def competitors(
    task: Task, peer_python: Path | None = None, vocabulary: Path | None = None, added: Sequence[str] = ()
) -> Competitors:
    """Return the methods to compare.

    Args:
        task: Localisers or matchers.
        peer_python: Interpreter that may have the peers.
        vocabulary: Text file with ORB-SLAM3's vocabulary.
        added: More methods, as `--method` names them.

    Raises:
        MethodError: If an interpreter or an added method is none.
    """
    ours, *others = BUILT_IN[task].values()
    present, missing = [replace(ours, name=OURS), *others], {}
    for name, peer in PEERS[task].items():
        found, reason = find_peer(peer, peer_python, {} if vocabulary is None else {"vocabulary": vocabulary})
        if found is None:
            missing[name] = reason
        else:
            present.append(found)
    return Competitors((*present, *(find_method(spec, task) for spec in added)), missing)
