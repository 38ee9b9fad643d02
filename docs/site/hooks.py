"""Hooks of MkDocs: pages from outside docs/, an API page for each public module, mathematics as MathML.

Pages outside docs/ keep their paths, so that links between pages work in the repository and on the site. Mathematics
is written in blocks ``math`` (LaTeX), which are translated when the site is built; browsers draw MathML themselves.
"""

from __future__ import annotations

import ast
import posixpath
import re
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from xml.etree.ElementTree import Element

from pointing_analysis.files.structured_text import load_toml

ROOT = Path(__file__).parents[2]
OUTSIDE = {"README.md": "overview.md"} | {
    page: page
    for page in (
        "CONTRIBUTING.md",
        "CHANGELOG.md",
        "bags/README.md",
        "lftkit/README.md",
        "pointing_analysis/README.md",
        "ros_ws/README.md",
    )
}
"""Pages of the repository outside docs/ that are part of the site, and their names there (index.md is the start)."""
PACKAGES = {
    name: ROOT / name if (ROOT / name).is_dir() else ROOT / "ros_ws/src/los_testbed" / name
    for name in load_toml((ROOT / "pyproject.toml").read_text("utf-8"), "pyproject.toml")["tool"]["mypy"]["packages"]
}
LINK = re.compile(r"\[((?:`[^`]*`|[^\[\]`])*)\]\(([^)#:]+\.md|[\w./-]+/?)((?:#[^)]*)?)\)")
PICTURE = re.compile(r'(<img src=")([^":]+)(")')
EMPTY_HEAD = re.compile(r"<th((?: [^>]*)?)></th>")
FIGURE = re.compile(r'(<img [^>]*src="([^"]*figures/[^"]*)"[^>]*>)')
INLINE_CODE = re.compile(r"(?<!<pre>)(?<!</span>)<code>([^<]+)</code>")
SHORT = 24
"""Characters of code that is kept on one line of a sentence."""
OPTION = re.compile(r"(?<![\w-])--?[A-Za-z][\w-]*")
CELL = re.compile(r"<td((?: [^>]*)?)>((?:(?!</td>).)*)</td>", re.DOTALL)
NOT_FOUND = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Page not found - {title}</title>
<style>
:root {{ color-scheme: light dark; }}
a {{ color: inherit; }}
body {{ font: 1.1rem/1.5 sans-serif; max-width: 36rem; margin: 4rem auto; padding: 0 1rem; }}
</style>
</head>
<body>
<main>
<h1>Page not found</h1>
<p>There is no page at this address. <a id="start" href="{start}">The documentation of {title}</a> begins here.</p>
</main>
<script>if (location.protocol === "file:") document.getElementById("start").href = "index.html";</script>
</body>
</html>
"""
ROLE = re.compile(r":(?:class|func|meth|mod|data|attr|exc):`(~?)([\w.]+)`")


def public_names(path: Path) -> list[str]:
    """Names of the functions and classes that a module defines for others, and of its documented constants."""
    body = ast.parse(path.read_text("utf-8")).body
    names = [
        node.name
        for node in body
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)) and not node.name.startswith("_")
    ]
    targets = [t for node in body if isinstance(node, ast.Assign) for t in node.targets]
    targets += [node.target for node in body if isinstance(node, ast.AnnAssign)]
    return names + [t.id for t in targets if isinstance(t, ast.Name) and not t.id.startswith("_")]


def exported(path: Path) -> dict[str, str]:
    """Names that ``__init__.py`` of a package passes on, with the modules that define them."""
    if path.name != "__init__.py":
        return {}
    imports = [node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.ImportFrom)]
    own = [node for node in imports if str(node.module).split(".")[0] in PACKAGES]
    return {alias.asname or alias.name: f"{node.module}.{alias.name}" for node in own for alias in node.names}


def modules() -> dict[str, Path]:
    """Every module with something public to show, by its dotted name."""
    found = {}
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            parts = [package, *path.relative_to(folder).with_suffix("").parts]
            if "build" in parts[:-1]:  # which `pip install ./lftkit` leaves behind
                continue
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            if not any(part.startswith("_") for part in name.split(".")) and (public_names(path) or exported(path)):
                found[name] = path
    return found


def api_page(name: str, path: Path) -> str:
    """Markdown of the page of one module."""
    text = f"::: {name}\n"
    if names := exported(path):
        text += "    options: {members: false}\n\n| name | defined in |\n|---|---|\n"
        text += "".join(
            f"| [`{short}`][{full}] | `{full.rpartition('.')[0]}` |\n" for short, full in sorted(names.items())
        )
    return text


def api_nav() -> list[Any]:
    """Navigation of the API reference: packages, then their modules."""
    groups: dict[str, list[Any]] = {}
    for name in modules():
        groups.setdefault(name.split(".")[0], []).append({name: f"api/{name}.md"})
    return [{package: pages} for package, pages in groups.items()]


def on_config(config: Any) -> Any:
    """Add the API reference to the navigation, and the translations to the Markdown extensions."""
    config.nav.insert(-1, {"API": api_nav()})
    config.markdown_extensions.append(_roles())
    config.mdx_configs.setdefault("pymdownx.superfences", {})["custom_fences"] = [
        {"name": "math", "class": "math", "format": mathml}
    ]
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the pages outside docs/ and those of the API."""
    from mkdocs.structure.files import File

    for path, page in OUTSIDE.items():
        files.append(File.generated(config, page, content=(ROOT / path).read_text("utf-8")))
    for name, path in modules().items():
        files.append(File.generated(config, f"api/{name}.md", content=api_page(name, path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links between docs/ and the other folders of the repository become links of the site."""
    source = page.file.src_uri
    if source.startswith("api/"):
        return markdown
    text = PICTURE.sub(lambda match: match[1] + site_link(source, match[2]) + match[3], markdown)
    return LINK.sub(lambda match: linked(source, *match.groups()), text)


def on_page_content(html: str, **_: Any) -> str:
    """Empty heads of tables are cells: a head without text has no name for assistive technology.

    Cells of four or more words are of the class ``prose``: on a phone their column is not as narrow as one word. A
    figure is a link to itself: on a phone it opens at its own size. Short code is of the class ``short``, options in
    code of the class ``option``: they are not broken at their hyphens. Paths may be broken behind a slash.

    Examples
    --------
    >>> on_page_content('<tr><th></th><th align="left"></th><th>stage</th></tr>')
    '<tr><td></td><td align="left"></td><th>stage</th></tr>'
    >>> on_page_content("<tr><td>12.5 of 40</td><td>what the run has recorded</td></tr>")
    '<tr><td>12.5 of 40</td><td class="prose">what the run has recorded</td></tr>'
    >>> on_page_content('<p><img alt="Star" src="figures/star.png" /></p>')
    '<p><a href="figures/star.png"><img alt="Star" src="figures/star.png" /></a></p>'
    >>> on_page_content("<p>with <code>--time none</code></p>")
    '<p>with <code class="short"><span class="option">--time</span> none</code></p>'
    >>> on_page_content("<td><code>examples/spacecraft/moving_rotors.toml</code></td>")
    '<td><code>examples/<wbr>spacecraft/<wbr>moving_rotors.toml</code></td>'
    >>> on_page_content("<pre><span></span><code>los-testbed run --output bags/1</code></pre>")
    '<pre><span></span><code>los-testbed run --output bags/1</code></pre>'
    """
    linked_figures = FIGURE.sub(r'<a href="\2">\1</a>', INLINE_CODE.sub(_code, html))
    return CELL.sub(_cell, EMPTY_HEAD.sub(r"<td\1></td>", linked_figures))


def _code(match: re.Match[str]) -> str:
    options = OPTION.sub(r'<span class="option">\g<0></span>', match[1])
    if len(match[1]) <= SHORT:
        return f'<code class="short">{options}</code>'
    return f"<code>{re.sub('(?<![</])/(?=[a-zA-Z_])', '/<wbr>', options)}</code>"


def _cell(match: re.Match[str]) -> str:
    words = re.sub(r"<[^>]*>", " ", match[2]).split()
    prose = len(words) >= 4 and sum(word.isalpha() for word in words) >= 3 and "class=" not in match[1]
    return f'<td class="prose"{match[1]}>{match[2]}</td>' if prose else match[0]


def on_post_template(output: str, template_name: str, config: Any) -> str:
    """The page for addresses that do not exist needs no other file: a server shows it in any folder."""
    if template_name != "404.html":
        return output
    start = urlsplit(config.site_url or "/").path or "/"
    return NOT_FOUND.format(title=config.site_name, start=start)


def linked(source: str, text: str, target: str, anchor: str) -> str:
    """Link of the site; the text alone where the target is no page of it, such as a folder of examples.

    Examples
    --------
    >>> linked("overview.md", "glossary", "docs/glossary.md", "#design"), linked("overview.md", "x", "examples", "")
    ('[glossary](glossary.md#design)', 'x')
    """
    on_site = target.endswith(".md") or repository_path(source, target).startswith("docs/")
    return f"[{text}]({site_link(source, target)}{anchor})" if on_site else text


def repository_path(source: str, target: str) -> str:
    """Path in the repository of what a page of the site links to."""
    paths = {page: path for path, page in OUTSIDE.items()}
    folder = posixpath.dirname(paths.get(source, f"docs/{source}"))
    return posixpath.normpath(posixpath.join(folder, target))


def site_link(source: str, target: str) -> str:
    """Link on a page of the site for one that is written relative to the page's place in the repository.

    Examples
    --------
    >>> site_link("real_time.md", "../ros_ws/README.md"), site_link("ros_ws/README.md", "../docs/glossary.md")
    ('ros_ws/README.md', '../glossary.md')
    >>> site_link("index.md", "../README.md"), site_link("real_time.md", "glossary.md")
    ('overview.md', 'glossary.md')
    >>> site_link("overview.md", "docs/figures/report.png")
    'figures/report.png'
    """
    path = repository_path(source, target)
    return posixpath.relpath(OUTSIDE.get(path, path.removeprefix("docs/")), posixpath.dirname(source) or ".")


def mathml(source: str, language: str, css_class: str, options: Any, md: Any, **_: Any) -> str:
    """Block of LaTeX as MathML.

    Raises
    ------
    ValueError
        An environment that the translation does not know.
    """
    from latex2mathml.converter import convert

    if "{aligned}" in source or "{gathered}" in source:
        raise ValueError(f"block of mathematics must use split or align*, got {source!r}")
    return f'<div class="{css_class}">{convert(source, display="block")}</div>'


def _roles() -> Any:
    """Markdown extension: cross-references of docstrings (``:func:`name```) become links."""
    from markdown.extensions import Extension
    from markdown.inlinepatterns import InlineProcessor

    class Role(InlineProcessor):
        def handleMatch(self, m: Any, data: str) -> tuple[Element, int, int]:  # type: ignore[override]
            element = Element("autoref", {"identifier": m[2], "optional": ""})
            code = Element("code")
            code.text = m[2].rpartition(".")[2] if m[1] else m[2]
            element.append(code)
            return element, m.start(0), m.end(0)

    class Roles(Extension):
        def extendMarkdown(self, md: Any) -> None:
            md.inlinePatterns.register(Role(ROLE.pattern, md), "role", 195)

    return Roles()
