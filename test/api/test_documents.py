"""The Python examples of the documentation run unchanged: the page, beside a data set, and the notebook."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path

import pytest

from helpers import ROOT

PAGE = next(iter(sorted((ROOT / "docs").rglob("python.md"))))


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


@pytest.mark.slow
def test_ten_lines_end_with_a_figure_and_a_verdict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cells run in this process, as Jupyter's kernel would run them."""
    interactive = pytest.importorskip("IPython.core.interactiveshell", reason="IPython is not installed")
    capture = pytest.importorskip("IPython.utils.capture").capture_output
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path))
    monkeypatch.setitem(sys.modules, "__main__", sys.modules["__main__"])  # which the shell replaces
    monkeypatch.chdir(ROOT / "examples")
    notebook = json.loads(Path("from_python.ipynb").read_text(encoding="utf-8"))
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert sum(len([line for line in cell.splitlines() if line]) for cell in cells) <= 10
    shell = interactive.InteractiveShell(user_ns={})
    shell.display_formatter.active_types = ["text/plain", "text/html"]
    shown = []
    for cell in cells:
        with capture() as printed:
            done = shell.run_cell(cell)
        done.raise_error()
        shown.append(done.result)
        assert not printed.stderr
    texts = [shell.display_formatter.format(each)[0] for each in (shown[0], shown[2], shown[4])]
    assert "210 localisation pairs" in texts[0]["text/html"]
    assert "<table" in texts[1]["text/html"]
    assert shown[3].data[0].name == "truth"
    assert "'pass'" in texts[2]["text/plain"]
