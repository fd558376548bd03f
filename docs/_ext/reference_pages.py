"""Reference pages made from the code: the comment `<!-- generated: NAME -->` of a page is replaced by the build.

Commands come from typer, parameters from the frozen dataclasses, the keys of the score from its records. The pages
therefore cannot become outdated. Tables that readers of the source text need are kept in the repository, between
`<!-- begin: NAME -->` and `<!-- end: NAME -->`. `python docs/_ext/reference_pages.py` writes them, and a test compares
them with the code.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin, get_type_hints

import msgspec

if TYPE_CHECKING:
    from sphinx.application import Sphinx

POLICY = Path(__file__).resolve().parents[2] / "config" / "sros2_policy.xml"
DOCS = Path(__file__).resolve().parents[1]
MARK = re.compile(r"<!-- generated: ([a-z_]+) -->")
KEPT = re.compile(r"(?s)(<!-- begin: ([a-z_]+) -->\n).*?(<!-- end: \2 -->)")


def commands() -> str:
    """Return the reference of `sfr` and all its subcommands."""
    import typer

    from sfr_loc_map.cli.main import app

    return "\n".join(_command(typer.main.get_command(app), "sfr", None))


def _command(command: Any, path: str, parent: Any) -> Iterator[str]:  # noqa: ANN401 - of click or typer's copy of it
    context_type = command.context_class
    context = context_type(command, info_name=path, parent=parent, **command.context_settings)
    yield f"## {path}\n"
    usage = " ".join(command.collect_usage_pieces(context))
    yield f"```text\n{path} {usage}\n```\n"
    yield inspect.cleandoc(command.help or "") + "\n"
    records = [record for param in command.get_params(context) if (record := param.get_help_record(context))]
    for names, text in records:
        yield f"`{names.replace('|', ' | ')}`\n: {_prose(text) or '-'}\n"
    epilog = inspect.cleandoc(command.epilog or "")
    if epilog.startswith("Examples:"):
        yield "Examples:\n\n```sh\n" + "\n".join(epilog.partition("\n")[2].split("\n\n")).strip() + "\n```\n"
    elif epilog:
        yield epilog + "\n"
    for name in command.list_commands(context) if hasattr(command, "commands") else ():
        if not (child := command.commands[name]).hidden:
            yield from _command(child, f"{path} {name}", context)


def _prose(text: str) -> str:
    """Return a help text as Markdown; brackets, stars and angles are letters, code stays code."""
    parts = " ".join(text.split()).split("`")
    parts[::2] = [re.sub(r"([\[\]<>*_$])", r"\\\1", part) for part in parts[::2]]
    return "`".join(parts)


def parameters() -> str:
    """Return the parameters of the three nodes, then those of the simulator."""
    from sfr_loc_map.configuration.parameters import parameters as declared
    from sfr_loc_map.nodes.parameter_files import FILES
    from sfr_loc_map.simulation.config import SimulationConfig

    groups = [(f"`{node}` (`config/{file}`)", config) for file, (node, config) in FILES.items()]
    groups.append(("`sfr simulate`", SimulationConfig))
    parts = []
    for title, config in groups:
        parts.append(f"## {title}\n")
        parts += [_parameter(info) for info in declared(config)]
    return "\n".join(parts)


def configuration() -> str:
    """Return the keys of `sfr.yaml` that say how a source is read, section by section."""
    from sfr_loc_map.configuration.parameters import parameters as declared
    from sfr_loc_map.configuration.sections import Configuration
    from sfr_loc_map.io.source_config import SourceConfig

    parts = []
    for name, config in get_type_hints(SourceConfig).items():
        if dataclasses.is_dataclass(config) and config is not Configuration:
            parts.append(f"### `{name}`\n\n{_prose(inspect.cleandoc(config.__doc__ or ''))}\n")
            parts += [_parameter(info) for info in declared(config)]
    return "\n".join(parts)


def _parameter(info: Any) -> str:  # noqa: ANN401 - a ParamInfo
    default = list(info.default) if isinstance(info.default, tuple) else info.default
    facts = [f"default `{default!r}`"]
    if info.unit:
        facts.append(f"unit {info.unit}")
    if info.choices:
        facts.append("one of " + ", ".join(f"`{choice or repr(choice)}`" for choice in info.choices))
    if info.low is not None:
        facts.append(f"{info.low:g} to {info.high:g}")
    return f"`{info.name}`\n: {_prose(info.doc)} ({'; '.join(facts)})\n"


def score() -> str:
    """Return the keys of the score, record by record."""
    from sfr_loc_map.metrics.score.score import Score

    seen: list[type] = []
    parts = []
    waiting: list[type] = [Score]
    while waiting:
        record = waiting.pop(0)
        if record in seen:
            continue
        seen.append(record)
        parts.append(_record(record))
        waiting += [kind for hint in get_type_hints(record).values() for kind in _records_in(hint)]
    return "\n".join(parts)


def _record(record: type) -> str:
    docs = _field_docs(record)
    hints = get_type_hints(record)
    lines = [f"## {record.__name__}\n", _prose(inspect.cleandoc(record.__doc__ or "")) + "\n"]
    for item in msgspec.structs.fields(record):
        prose = _prose(docs.get(item.name, ""))
        lines.append(f"`{item.encode_name}`\n: {prose} ({_type_name(hints[item.name])})\n")
    return "\n".join(lines)


def _field_docs(record: type) -> dict[str, str]:
    """Return the comments `#:` beside or above the fields of a record."""
    docs: dict[str, str] = {}
    for kind in record.__mro__:
        if not kind.__module__.startswith("sfr_loc_map"):  # msgspec's own base
            continue
        above: list[str] = []
        for line in inspect.getsource(kind).splitlines():
            code, _, comment = line.partition("#: ")
            above.append(comment)
            if found := re.match(r" {4}(\w+): ", code):
                docs[found[1]] = " ".join(filter(None, above))
            if code.strip():
                above = []
    return docs


def _records_in(hint: Any) -> list[type]:  # noqa: ANN401 - any annotation
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return [hint]
    return [kind for part in get_args(hint) for kind in _records_in(part)]


def _type_name(hint: Any) -> str:  # noqa: ANN401 - any annotation
    origin, parts = get_origin(hint), get_args(hint)
    if hint is type(None):
        return "null"
    if origin in (Union, UnionType):
        return " or ".join(_type_name(part) for part in parts)
    if origin is Annotated:
        return _type_name(parts[0])
    if origin is not None and issubclass(origin, Mapping):
        return f"object of {_type_name(parts[1])}"
    if origin is not None and issubclass(origin, Sequence):
        return "array of " + _type_name(parts[0])
    if isinstance(hint, type) and issubclass(hint, Enum):
        return "one of " + ", ".join(f"`{member.value}`" for member in hint)
    if isinstance(hint, type) and issubclass(hint, str):
        return "text"
    if _records_in(hint):
        return f"[{hint.__name__}](#{hint.__name__.lower()})"
    names = {float: "number", int: "whole number", bool: "true or false", object: "any JSON"}
    return names.get(hint, getattr(hint, "__name__", str(hint)))


def topics() -> str:
    """Return topics and services of each node, from the policy that a test compares with the running nodes."""
    import xml.etree.ElementTree as ET

    parts = []
    for profile in ET.parse(POLICY).getroot().iter("profile"):
        parts.append(f"## `{profile.get('node')}`\n")
        for title, path in (
            ("Publishes", "topics[@publish='ALLOW']/topic"),
            ("Subscribes to", "topics[@subscribe='ALLOW']/topic"),
            ("Answers", "services[@reply='ALLOW']/service"),
            ("Calls", "services[@request='ALLOW']/service"),
        ):
            names = sorted(item.text or "" for item in profile.findall(path))
            if names:
                parts.append(f"{title}\n: " + ", ".join(f"`{name}`" for name in names) + "\n")
    return "\n".join(parts)


PACKAGES = (
    "",
    "geometry",
    "io",
    "localisation",
    "mapping",
    "metrics",
    "runs",
    "scoring",
    "report",
    "methods",
    "simulation",
    "faults",
)
"""Packages whose public names are described; those of the nodes need ROS and are explained in nodes.md."""


def api() -> str:
    """Return directives of autodoc for the public names of each package."""
    import importlib

    parts: list[str] = []
    seen: list[int] = []
    for name in PACKAGES:
        path = f"sfr_loc_map.{name}".rstrip(".")
        package = importlib.import_module(path)
        parts += [f"## {path}", "", (package.__doc__ or "").strip().partition("\n")[0], "", "```{eval-rst}"]
        for public in sorted(set(package.__all__)):
            value = getattr(package, public)
            kind = "autoclass" if inspect.isclass(value) else "autofunction" if inspect.isroutine(value) else None
            if kind is not None and not get_args(value) and id(value) not in seen:  # an alias has nothing to say
                seen.append(id(value))
                inherited = ["   :inherited-members:"] if not name and kind == "autoclass" else []  # files, plots
                parts += [f".. {kind}:: {path}.{public}", *inherited, ""]
        parts += ["```", ""]
    return "\n".join(parts)


def shortfalls() -> str:
    """Return the table of the kinds of missing and wrong data, and when a result is complete."""
    from sfr_loc_map.metrics.completeness.shortfall_kinds import SHORTFALLS
    from sfr_loc_map.metrics.figures.catalogue import JUDGED

    lines = [
        "| part of `judged` | figure | fraction of | complete up to, with limits | without limits | allowed by |",
        "|---|---|---|---|---|---|",
        f"| all | `{JUDGED}` | expected items | any known fraction | any | `--partial` |",
    ]
    for kind in SHORTFALLS:
        accepting = [] if kind.limit_name is None else [f"`{kind.limit_name}`"]
        for each in kind.accepted_by:
            accepting.append(f"`{each.limit}`" + (" if the images are unknown" if each.only_without_images else ""))
        accepting += ["`--partial`"] if kind.partial and kind.most is not None else []
        bounds = ["any" if most is None else f"{most:g}" for most in (kind.most, kind.most_without_limits)]
        cells = (f"`{kind.scope}`", f"`{kind.figure}`", kind.expected, *bounds, ", ".join(accepting) or "-")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def evidence() -> str:
    """Return the table of the kinds of evidence of a check: what they show and hide, and which decide the result."""
    from sfr_loc_map.evidence.kinds import KINDS

    lines = ["| table | shown | hidden | decides the result |", "|---|---|---|---|"]
    for kind in KINDS:
        lines.append(f"| {kind.title} | {kind.shows} | {kind.hides} | {'yes' if kind.decides else 'no'} |")
    return "\n".join(lines)


PAGES: dict[str, Callable[[], str]] = {
    "commands": commands,
    "parameters": parameters,
    "configuration": configuration,
    "topics": topics,
    "score": score,
    "evidence": evidence,
    "api": api,
}
TABLES: dict[str, Callable[[], str]] = {"shortfalls": shortfalls}
"""The tables that are kept in the pages."""


def with_tables(page: str) -> str:
    """Return the text of a page whose kept tables are those of the code."""
    return KEPT.sub(lambda found: f"{found[1]}{TABLES[found[2]]()}\n{found[3]}", page)


def write_tables() -> None:
    """Write the tables that are kept in the pages."""
    for path in DOCS.rglob("*.md"):
        page = path.read_text(encoding="utf-8")
        if KEPT.search(page):
            path.write_text(with_tables(page), encoding="utf-8")


def _fill(app: Sphinx, name: str, source: list[str]) -> None:
    source[0] = MARK.sub(lambda found: PAGES[found[1]](), source[0])


def _code_spans(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Turn code spans of docstrings, which have single backticks, into those of reStructuredText."""
    text = re.sub(r"(?<!`)`([^`]+)`(?!`)", lambda span: f"``{span[1].strip()}``", "\n".join(lines))
    lines[:] = text.split("\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Fill the pages as they are read."""
    app.connect("autodoc-process-docstring", _code_spans)
    app.connect("source-read", _fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    write_tables()
