"""The mutations of `make mutants`: the text of each mutation occurs once in its file, and the mutated file is valid."""

import ast
import importlib.util
import sys

from helpers import ROOT


def test_each_mutation_changes_one_place_of_its_file() -> None:
    spec = importlib.util.spec_from_file_location("mutants", ROOT / "tools" / "mutants.py")
    mutants = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = mutants
    spec.loader.exec_module(mutants)
    wrong = []
    for mutation in mutants.MUTATIONS:
        text = (ROOT / "sfr_loc_map" / mutation.path).read_text(encoding="utf-8")
        if text.count(mutation.text) != 1 or mutation.text == mutation.instead:
            wrong.append(f"{mutation.path}: {mutation.text}")
        ast.parse(text.replace(mutation.text, mutation.instead), mutation.path)  # every test fails for invalid syntax
    assert not wrong
