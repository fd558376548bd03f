"""The page about Python runs as it stands, in a folder that has a data set."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = next(iter(sorted(DOCS.rglob("python.md"))))


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_snippets_run_in_their_order(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed")
    snippets = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len(snippets) > 5
    shutil.copytree(folder, tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for snippet in snippets:
        exec(compile(snippet, str(PAGE), "exec"), names)
    assert (tmp_path / "report.html").is_file()
    assert len(names["trajectory"]) == 6  # type: ignore[arg-type]
