"""The Python examples of the documentation run unchanged: the page, beside a data set, and the notebook."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from helpers import ROOT

PAGE = next(iter(sorted((ROOT / "docs").rglob("python.md"))))
FIGURE = "application/vnd.plotly.v1+json"


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
@pytest.mark.timeout(300)
def test_ten_lines_end_with_a_figure_and_a_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    needed = ("nbformat", "nbclient", "ipykernel")
    nbformat, nbclient, _ = (pytest.importorskip(name, reason=f"{name} is not installed") for name in needed)
    monkeypatch.setenv("PLOTLY_RENDERER", "plotly_mimetype")  # without 4 MB of script
    notebook = nbformat.read(ROOT / "examples" / "from_python.ipynb", as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert sum(len([line for line in cell.source.splitlines() if line]) for cell in code) <= 10
    nbclient.NotebookClient(notebook, timeout=280, resources={"metadata": {"path": str(ROOT / "examples")}}).execute()
    assert not [item for cell in code for item in cell.outputs if item.output_type in ("error", "stream")]
    shown = [cell.outputs[0].data for cell in code]
    assert "210 localisation pairs" in shown[0]["text/html"]
    assert "<table" in shown[2]["text/html"]
    assert shown[3][FIGURE]["data"][0]["name"] == "truth"
    assert "'pass'" in shown[4]["text/plain"]
