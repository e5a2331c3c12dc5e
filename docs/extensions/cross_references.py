"""Names and commands in the text as links: to the reference, and to the page of commands."""

from __future__ import annotations

import importlib
import re
from functools import cache
from importlib.util import find_spec
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.transforms import SphinxTransform

PACKAGES = ("lensdesign", "wavesim", "tolerancing", "studio")
DOTTED = re.compile(rf"(?:{'|'.join(PACKAGES)})\.\w[\w.]*")
COMMAND = re.compile(r"(lensdesign|wavesim|tolerancing) ([a-z-]+)\b")
# Pages on which a public name of a package, by itself, means just that.
PACKAGE_OF_PAGE = {"docs/engines": "wavesim", "docs/reconstruction": "wavesim"}
COMMANDS_PAGE = "docs/commands"


class NamesAsLinks(SphinxTransform):
    """Link what stands as code, where there is something to link to."""

    default_priority = 900

    def apply(self, **_: Any) -> None:
        page = self.env.docname
        for link in self.document.findall(pending_xref):
            link.attributes.pop(
                "refspecific", None
            )  # It asks for a search in all names, which takes minutes.
        for literal in list(self.document.findall(nodes.literal)):
            if isinstance(literal.parent, nodes.reference | pending_xref | nodes.title):
                continue
            link = self._link(literal.astext(), page)
            if link is not None:
                literal.replace_self(link)
                link += literal

    def _link(self, text: str, page: str) -> nodes.Element | None:
        command = COMMAND.match(text)
        if command and page != COMMANDS_PAGE and command[2] in _commands(command[1]):
            # Without a target of its own, a heading has the anchor that its words give.
            uri = f"{COMMANDS_PAGE}#{command[1]}-{command[2]}"
            return pending_xref(refdomain="", reftype="command", reftarget=uri, refdoc=page)
        package = PACKAGE_OF_PAGE.get(page)
        if package is not None and text in importlib.import_module(package).__all__:
            text = f"{package}.{text}"
        if not DOTTED.fullmatch(text):
            return None
        return pending_xref(refdomain="py", reftype="obj", reftarget=text, refdoc=page, from_text=True)


def _resolved(app: Any, env: Any, node: pending_xref, inner: nodes.Element) -> nodes.Node | None:
    """Resolve commands, and names that are exported, or written without their module."""
    if node["reftype"] == "command":
        page, anchor = node["reftarget"].split("#")
        uri = f"{app.builder.get_relative_uri(node['refdoc'], page)}#{anchor}"
        return nodes.reference("", "", inner, internal=True, refuri=uri)
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    defined = _definition(target, node.get("py:module"), node.get("py:class"))
    if defined is None and "." not in target:
        defined = _by_last_part(env).get(target)
    entry = env.domains.python_domain.objects.get(defined)
    if entry is not None:
        uri = f"{app.builder.get_relative_uri(node['refdoc'], entry.docname)}#{entry.node_id}"
        return nodes.reference("", "", inner, internal=True, refuri=uri, reftitle=defined)
    # Types of other packages have no page here, nor have our own names that are not public. A role must name
    # what exists; text may also name what once did.
    is_role = isinstance(inner, nodes.literal) and "from_text" not in node
    is_ours = "." not in target or DOTTED.fullmatch(target)
    return None if is_role and is_ours and defined is None else inner


@cache
def _definition(name: str, module: str | None, in_class: str | None) -> str | None:
    """Return the name of an object in the module that defines it, or None if there is none of that name.

    Parameters
    ----------
    name
        A name with its package, or as the module or the class understands it.
    module, in_class
        Where the name stands.
    """
    if DOTTED.fullmatch(name):
        return _defining_name(name)
    if module is None:
        return None
    return _defining_name(f"{module}.{name}") or (in_class and _defining_name(f"{module}.{in_class}.{name}"))


def _defining_name(dotted: str) -> str | None:
    first, *parts = dotted.split(".")
    found: Any = importlib.import_module(first)
    name, owner = first, found
    for part in parts:
        owner, name = found, f"{name}.{part}"
        try:
            found = getattr(found, part)
        except AttributeError:
            if not hasattr(found, "__path__") or find_spec(name) is None:
                return None
            found = importlib.import_module(name)
    if hasattr(found, "__qualname__"):
        return f"{found.__module__}.{found.__qualname__}"
    if hasattr(owner, "__qualname__"):  # a property
        return f"{owner.__module__}.{owner.__qualname__}.{parts[-1]}"
    return name


def _by_last_part(env: Any) -> dict[str, str]:
    """Return documented classes and functions by their last names, where only one has it."""
    if not hasattr(env, "documented_by_last_part"):
        found: dict[str, list[str]] = {}
        for name, entry in env.domains.python_domain.objects.items():
            if entry.objtype in ("class", "exception", "function"):
                found.setdefault(name.rpartition(".")[2], []).append(name)
        env.documented_by_last_part = {last: names[0] for last, names in found.items() if len(names) == 1}
    return env.documented_by_last_part


@cache
def _commands(package: str) -> frozenset[str]:
    import typer

    group: Any = typer.main.get_command(importlib.import_module(f"{package}.cli.commands").app)
    return frozenset(group.commands)


def setup(app: Any) -> dict[str, bool]:
    """Add the transform, and what resolves its links."""
    app.add_transform(NamesAsLinks)
    app.connect("missing-reference", _resolved)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
