"""The pages of the documentation name only existing files, links and targets."""

import importlib.util
import re
from types import ModuleType

import pytest

from helpers import ROOT
from sfr_loc_map.issues import Cause

PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
MODULE = re.compile(r"(?<![\w/.*}])((?:[a-z_]+/)*[a-z_]+\.py)\b")
LINK = re.compile(r"\]\(([^)#:]+)(?:#[\w-]*)?\)")


def _reference_pages() -> ModuleType:
    """Return the extension of the documentation that makes pages from the code."""
    spec = importlib.util.spec_from_file_location("reference_pages", ROOT / "docs" / "_ext" / "reference_pages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


REFERENCE_PAGES = _reference_pages()
MARKS = sorted({name for page in PAGES for name in REFERENCE_PAGES.MARK.findall(page.read_text(encoding="utf-8"))})


@pytest.mark.parametrize("mark", MARKS)
def test_each_generated_page_is_made_from_the_code(mark: str) -> None:
    assert len(REFERENCE_PAGES.PAGES[mark]().splitlines()) > 5


def test_the_kept_tables_are_those_of_the_code() -> None:
    kept = {page: text for page in PAGES if REFERENCE_PAGES.KEPT.search(text := page.read_text(encoding="utf-8"))}
    assert kept
    for page, text in kept.items():
        assert text == REFERENCE_PAGES.with_tables(text), f"{page}: run python docs/_ext/reference_pages.py"


def test_modules_and_links_are_there() -> None:
    modules = [path.relative_to(ROOT).as_posix() for path in ROOT.glob("[a-z]*/**/*.py")]
    tails = {"/".join(name.split("/")[i:]) for name in modules for i in range(name.count("/") + 1)}
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not [n for n in sorted(set(MODULE.findall(text)) - tails) if not (ROOT / n).exists()], page
        assert not [link for link in LINK.findall(text) if not (page.parent / link).exists()], page


def test_each_code_of_the_doctor_has_its_section() -> None:
    page = (ROOT / "docs" / "howto" / "troubleshooting.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^### `(\w+)`$", page, re.MULTILINE)) == set(Cause)


def test_targets_of_make_are_there() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    named = {name for page in PAGES for name in re.findall(r"`make ([a-z-]+)", page.read_text(encoding="utf-8"))}
    assert named
    assert named <= targets


def test_every_formula_of_the_metrics_has_its_equation() -> None:
    page = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    section = page.partition("\n## The formulas\n")[2].partition("\n## ")[0]
    named = re.findall(r"\[`(\w+)`\]\(\.\./sfr_loc_map/metrics/(?:formulas|other_formulas)\.py\)", section)
    modules = [ROOT / "sfr_loc_map" / "metrics" / name for name in ("formulas.py", "other_formulas.py")]
    code = "\n".join(module.read_text(encoding="utf-8") for module in modules)
    defined = re.findall(r"^def ([a-z]\w*)\(", code, re.MULTILINE)
    assert {*named} == {*defined} - {"statistics"}
