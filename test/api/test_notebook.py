"""The notebook runs as it stands: it ends with a figure and a verdict."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FIGURE = "application/vnd.plotly.v1+json"


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_ten_lines_end_with_a_figure_and_a_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed: no notebook can be read")
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: no notebook can be run")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed: no notebook can be run")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("PLOTLY_RENDERER", "plotly_mimetype")  # without 4 MB of script
    notebook = nbformat.read(ROOT / "examples" / "from_python.ipynb", as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert sum(len([line for line in cell.source.splitlines() if line]) for cell in code) <= 10
    nbclient.NotebookClient(notebook, timeout=280, resources={"metadata": {"path": str(ROOT / "examples")}}).execute()
    assert not [item for cell in code for item in cell.outputs if item.output_type in ("error", "stream")]
    shown = [cell.outputs[0].data for cell in code]
    assert "100 localisation pairs" in shown[0]["text/html"]
    assert "<table" in shown[2]["text/html"]
    assert shown[3][FIGURE]["data"][0]["name"] == "truth"
    assert shown[4]["text/plain"] == "'pass'"
