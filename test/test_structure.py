"""The size of the parts: what a reader can hold in mind. The limits are those of CONTRIBUTING.md."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import sfr_loc_map

radon = pytest.importorskip("radon.complexity", reason="radon is not installed: pip install '.[dev]'")

PACKAGE = Path(sfr_loc_map.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
MODULE_LINES, CLASS_LINES, FUNCTION_LINES = 300, 200, 50
PARAMETERS, ATTRIBUTES, COMPLEXITY = 7, 15, 12
Function = ast.FunctionDef | ast.AsyncFunctionDef


def lines_of(node: ast.ClassDef | Function) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def is_command(function: Function) -> bool:
    """Tell whether typer makes a command of it: each of its parameters is an option of the command line."""
    return any(".command" in ast.unparse(d) or ".callback" in ast.unparse(d) for d in function.decorator_list)


def parameters_of(function: Function) -> int:
    names = [a.arg for a in (*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs)]
    return len([name for name in names if name not in ("self", "cls")])


def attributes_of(node: ast.ClassDef) -> set[str]:
    assigned = {
        item.attr
        for item in ast.walk(node)
        if isinstance(item, ast.Attribute)
        and isinstance(item.ctx, ast.Store)
        and isinstance(item.value, ast.Name)
        and item.value.id == "self"
    }
    fields = {i.target.id for i in node.body if isinstance(i, ast.AnnAssign) and isinstance(i.target, ast.Name)}
    return assigned | fields


def excesses(text: str) -> list[str]:
    """Return what is larger than the limits in the text of a module."""
    found = [f"module: {count} lines"] if (count := len(text.splitlines())) >= MODULE_LINES else []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, Function):
            if lines_of(node) > FUNCTION_LINES:
                found.append(f"{node.name}: {lines_of(node)} lines")
            if parameters_of(node) > PARAMETERS and not is_command(node):
                found.append(f"{node.name}: {parameters_of(node)} parameters")
        elif isinstance(node, ast.ClassDef):
            if lines_of(node) > CLASS_LINES:
                found.append(f"class {node.name}: {lines_of(node)} lines")
            if len(attributes_of(node)) > ATTRIBUTES:
                found.append(f"class {node.name}: {len(attributes_of(node))} attributes")
    blocks = [block for block in radon.cc_visit(text) if type(block).__name__ == "Function"]
    return found + [f"{b.name}: complexity {b.complexity}" for b in blocks if b.complexity > COMPLEXITY]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_parts_are_small(path: Path) -> None:
    assert not excesses(path.read_text(encoding="utf-8"))


def test_excesses_are_seen() -> None:
    branches = "\n".join(f"    if a == {i}:\n        a += 1" for i in range(COMPLEXITY))
    assert excesses(f"def f(a):\n{branches}\n    return a\n") == ["f: complexity 13"]
    assert excesses("def f(a, b, c, d, *, e, f, g, h):\n    pass\n") == ["f: 8 parameters"]
    assert excesses("@app.command()\ndef f(a, b, c, d, e, f, g, h):\n    pass\n") == []
    assert excesses("def f():\n" + "    pass\n" * FUNCTION_LINES) == ["f: 51 lines"]
    assert excesses("class A:\n" + "".join(f"    a{i}: int\n" for i in range(16))) == ["class A: 16 attributes"]
    assert excesses("class A:\n    def m(self):\n" + "".join(f"        self.a{i} = 0\n" for i in range(16))) == [
        "class A: 16 attributes"
    ]
    assert excesses("pass\n" * MODULE_LINES) == ["module: 300 lines"]
