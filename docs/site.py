#!/usr/bin/env python3
"""Makes the documentation as a site for browsers, with navigation and a search: `make site`.

    docs/site.py [--out target/site/html]

Pages are the Markdown of the checkout as it stands, those of the notebooks with their pictures, and those of the
operations, which are made from openapi/openapi.json. They are staged at the places that they have in the checkout, so
that links between them hold; links to code, which is no page, become names of files. Fences of several languages in a
row become tabs. A link that leads nowhere, a page without a place and a resource of another host end this with 1.

The tools are those of docs/requirements.txt, in an environment that is made once; without it and without a way to
install it the site is skipped with a line that says so.
"""

import argparse
import html
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "docs")]

import environment  # noqa: E402
import site_api  # noqa: E402
import site_notebooks  # noqa: E402

TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve() / "site"
REQUIREMENTS = ROOT / "docs" / "requirements.txt"
PAGES = TARGET / "pages"

# Where pages stand. A pattern stands for the pages of a folder in the order of its README, which comes first. What is
# named nowhere is listed under the last heading.
NAVIGATION = {
    "Start": ["README.md", "docs/glossary.md"],
    "Tutorials": ["docs/tutorials/*", "notebooks/*"],
    "How to": [
        "docs/recipes/*",
        "docs/pipeline.md",
        "docs/clients.md",
        "clients/*",
        "crates/shapelex/README.md",
        "docs/dashboard.md",
        "docs/batches.md",
        "docs/tables.md",
        "docs/drawings.md",
        "docs/formats/*",
        "docs/images.md",
        "docs/segmentation.md",
    ],
    "Concepts": [
        "docs/conventions.md",
        "docs/names.md",
        "docs/dictionaries.md",
        "docs/classification.md",
        "docs/comparisons.md",
        "docs/models.md",
        "docs/blocks.md",
        "docs/symmetry.md",
        "docs/partial.md",
        "docs/retrieval.md",
        "docs/correspondence.md",
    ],
    "Mathematics": ["docs/sources.md", "docs/inhomogeneous.md"],
    "Reference": ["openapi/*", "docs/problems.md", "docs/limits.md", "docs/settings.md", "docs/events.md"],
    "Operation": [
        "docs/operations.md",
        "docs/access.md",
        "docs/maintenance.md",
        "docs/observability.md",
        "docs/reliability.md",
        "docs/scale.md",
        "SECURITY.md",
    ],
    "Evaluation": [
        "docs/evaluation.md",
        "docs/surfaces-evaluation.md",
        "docs/segmentation-evaluation.md",
        "docs/nuclei-evaluation.md",
        "docs/performance.md",
        "docs/benchmarks.md",
        "docs/weight.md",
        "docs/attack.md",
        "docs/reliability-fuzzing.md",
        "benches/*",
        "examples/*",
    ],
    "Development": ["ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/decisions/*"],
    "Further pages": ["*"],
}
# What a page may show or offer beside text.
ASSETS = {".png", ".svg", ".json"}
# Names of the tabs of languages; a fence of the shell that does not begin with curl has another one.
TABS = {"sh": "curl", "python": "Python", "r": "R", "typescript": "TypeScript"}
# Words after a fence that only tests of documents read.
FENCES = {"no_run": "rust", "ignore": "rust", "compile_fail": "rust"}
# Characters of a description in llms.txt.
LONGEST = 240

CONFIGURATION = """\
site_name: Shapelex
docs_dir: {pages}
site_dir: {out}
use_directory_urls: false
theme:
  name: material
  font: false
  language: en
  features: [navigation.tabs, navigation.indexes, navigation.top, toc.follow, content.tabs.link, content.code.copy,
    search.highlight]
  palette:
    - {{media: "(prefers-color-scheme: light)", scheme: default, primary: blue grey}}
    - {{media: "(prefers-color-scheme: dark)", scheme: slate, primary: blue grey}}
extra: {{generator: false}}
plugins: [search]
markdown_extensions:
  - attr_list
  - md_in_html
  - tables
  - toc: {{permalink: true, slugify: !!python/object/apply:pymdownx.slugs.slugify {{kwds: {{case: lower}}}}}}
  - pymdownx.superfences
  - pymdownx.tabbed: {{alternate_style: true}}
  - pymdownx.magiclink
  - pymdownx.highlight: {{anchor_linenums: false}}
validation:
  omitted_files: warn
  absolute_links: warn
  unrecognized_links: warn
  anchors: warn
  not_found: warn
nav: {nav}
"""

# A span of code, which has no links, or a link: its text, and where it leads.
LINK = re.compile(r"`[^`\n]*`|(!?)\[((?:[^\]`]|`[^`]*`)*)\]\(([^)\s]+)\)")
# A fence with its word, and what is in it.
FENCE = re.compile(r"^( *)(`{3,})([^\n`]*)\n(.*?)^\1\2[ \t]*$\n?", re.MULTILINE | re.DOTALL)


def prepared():
    """Python with the tools, installed once for every state of the list."""
    wanted, mark, folder = REQUIREMENTS.read_text(), TARGET / "env" / "installed.txt", TARGET / "env"
    if not (mark.exists() and mark.read_text() == wanted):
        environment.created(folder, ["-r", REQUIREMENTS], ["--no-deps", "--only-binary=:all:"])
        mark.write_text(wanted)
    return folder / "bin" / "python"


class Stage:
    """Pages and what they show, in a folder of their own; faults are collected."""

    def __init__(self):
        self.waiting, self.pages, self.faults = [], {}, []

    def take(self, path):
        """Stages a file of the checkout once, and remembers pages for their links."""
        if path not in self.pages:
            self.pages[path] = None
            self.waiting.append(path)

    def run(self):
        """Stages all pages, and those that they lead to."""
        shutil.rmtree(PAGES, ignore_errors=True)
        self.pages.update(site_api.pages(ROOT / "openapi" / "openapi.json"))
        for path, text in site_notebooks.pages(ROOT / "notebooks", PAGES).items():
            self.pages[path] = self.staged(path, text)
        for path in [*sorted((ROOT / "docs").rglob("*.md")), *sorted(ROOT.glob("*.md"))]:
            self.take(path.relative_to(ROOT).as_posix())
        while self.waiting:
            path = self.waiting.pop()
            self.pages[path] = self.staged(path, (ROOT / path).read_text(encoding="utf-8"))
        for path, text in self.pages.items():
            place = PAGES / path
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(text, encoding="utf-8")

    def staged(self, path, text):
        """A page as the site has it."""
        parts, begin = [], 0
        text = tabbed(text)
        for fence in FENCE.finditer(text):
            parts += [self.prose(path, text[begin : fence.start()]), fence.group(0)]
            begin = fence.end()
        return "".join([*parts, self.prose(path, text[begin:])])

    def prose(self, path, text):
        """Text between fences: its links, and blank lines before lists, which this dialect of Markdown needs."""
        text = LINK.sub(lambda found: self.link(path, found), text)
        return re.sub(r"(?m)^((?! *(?:[-*]|\d+\.) |\s*$|\|).*\n)(?=(?:[-*]|\d+\.) )", r"\1\n", text)

    def link(self, path, found):
        """A link as the site has it: to a page or a picture as it is, to code as the name of the file."""
        _, text, target = found.groups()
        named = re.fullmatch(r"`(docs/[\w./-]+\.md)`", found.group(0))
        if named:
            goal = os.path.relpath(named[1], pathlib.Path(path).parent)
            return self.link(path, LINK.match(f"[{found.group(0)}]({goal})"))
        if target is None or re.match(r"[a-z]+:|#", target):
            return found.group(0)
        name = target.partition("#")[0]
        if ((PAGES / path).parent / name).is_file():
            # A picture of a notebook, which is no file of the checkout, or one that was staged before.
            return found.group(0)
        place = (ROOT / path).parent / name
        if not place.exists() or ROOT not in [place.resolve(), *place.resolve().parents]:
            self.faults.append(f"{path}: a link to {target}, which does not exist")
            return found.group(0)
        goal = place.resolve().relative_to(ROOT).as_posix()
        if place.is_dir() and (place / "README.md").exists() and goal.startswith("docs"):
            self.take(f"{goal}/README.md")
            return f"[{text}]({name.rstrip('/')}/README.md)"
        if place.suffix == ".md":
            self.take(goal)
        elif place.suffix in ASSETS:
            copy = PAGES / goal
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(place, copy)
        elif place.suffix == ".ipynb":
            return f"[{text}]({name.removesuffix('.ipynb')}.md)"
        else:
            return f"{text} (`{goal}`)" if text.strip("`") not in (goal, place.name) else f"`{goal}`"
        return found.group(0)


def tabbed(text):
    """The text with fences in a row, of several languages, as tabs."""
    fences, rows = list(FENCE.finditer(text)), []
    for fence in fences:
        language = fence.group(3).strip()
        last = rows[-1][-1] if rows else None
        follows = last and language in TABS and last.group(3) in TABS and not text[last.end() : fence.start()].strip()
        if follows and language not in [one.group(3) for one in rows[-1]]:
            rows[-1].append(fence)
        else:
            rows.append([fence])
    for row in reversed(rows):
        shown = "\n".join(tab(fence) for fence in row) if len(row) > 1 else plain(row[0])
        text = text[: row[0].start()] + shown + text[row[-1].end() :]
    return text


def plain(fence):
    """A fence whose word is a language."""
    word = fence.group(3).strip().split(",")[0]
    return fence.group(0).replace(f"```{fence.group(3)}", f"```{FENCES.get(word, word)}", 1)


def tab(fence):
    """A fence as a tab."""
    name = TABS[fence.group(3)]
    if name == "curl" and not re.search(r"^curl|[ (]curl ", fence.group(4), re.MULTILINE):
        name = "Shell"
    lines = "".join(f"    {line}" if line.strip() else line for line in fence.group(0).splitlines(keepends=True))
    return f'=== "{name}"\n\n{lines}'


def title(text, path):
    """The first heading of a page."""
    found = re.search(r"^# (.+)$", text, re.MULTILINE)
    return re.sub(r"[`*]", "", found.group(1)) if found else path


def of_folder(folder, pages):
    """Pages of a folder in the order in which its README names them, the others after it."""
    readme = f"{folder}/README.md"
    inside = sorted(path for path in pages if path.startswith(f"{folder}/"))
    named = re.findall(r"\]\(([\w./-]+\.md)", pages.get(readme) or "")
    order = [readme, *(f"{folder}/{name}" for name in named)]
    return sorted(inside, key=lambda path: (order.index(path) if path in order else len(order), path))


def navigation(pages):
    """Headings with their pages, each page once."""
    left, found = set(pages), {}
    for heading, patterns in NAVIGATION.items():
        entries = []
        for pattern in patterns:
            if pattern == "*":
                listed = sorted(left)
            elif pattern.endswith("/*"):
                listed = [path for path in of_folder(pattern[:-2], pages) if path in left]
            else:
                listed = [pattern] if pattern in left else []
            left -= set(listed)
            is_folder = pattern.endswith("/*") and len(listed) > 1 and f"{pattern[:-2]}/README.md" in listed
            named = [{title(pages[path], path): path} for path in listed]
            if is_folder:
                entries.append({title(pages[listed[0]], pattern): [listed[0], *named[1:]]})
            else:
                entries += named
        if entries:
            found[heading] = entries
    return found


def first_sentence(text):
    """What a page is about: the first sentence of its first paragraph."""
    text = re.sub(r"^(#|\||!\[|<|===|    ).*$", "", FENCE.sub("", text), flags=re.MULTILINE)
    paragraphs = [
        part for part in re.split(r"\n\s*\n", text) if part.strip() and not re.match(r"\s*(\d+\.|[-*]) ", part)
    ]
    if not paragraphs:
        return ""
    words = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(paragraphs[0].split()))
    sentence = re.split(r"(?<=[.:]) (?=[A-Z`])", words)[0].rstrip(":")
    return sentence if len(sentence) <= LONGEST else f"{sentence[: LONGEST - 1].rsplit(' ', 1)[0]}…"


def flat(entries):
    """Titles and paths of entries of the navigation."""
    for entry in entries:
        if isinstance(entry, str):
            yield None, entry
            continue
        for name, inside in entry.items():
            if isinstance(inside, str):
                yield name, inside
            else:
                yield from flat(inside)


def list_of_pages(found, pages):
    """llms.txt: all pages, with a line each."""
    lines = ["# Shapelex", "", f"> {first_sentence(pages['README.md'])}", ""]
    for heading, entries in found.items():
        lines += [f"## {heading}", ""]
        for name, path in flat(entries):
            said = first_sentence(pages[path])
            lines.append(f"- [{name or title(pages[path], path)}]({path})" + (f": {said}" if said else ""))
        lines.append("")
    return "\n".join(lines)


def foreign(out):
    """Resources of other hosts that pages would load."""
    wanted = re.compile(
        r"<(?:script|img|iframe|source)\b[^>]*\bsrc=[\"']?(https?:)?//|<link\b[^>]*href=[\"']?(https?:)?//"
    )
    for path in sorted(out.rglob("*.html")):
        for found in wanted.finditer(path.read_text(encoding="utf-8")):
            yield f"{path.relative_to(out)}: loads {html.unescape(found.group(0))}…"
    for path in sorted(out.rglob("*.css")):
        if re.search(r"url\([\"']?(https?:)?//", path.read_text(encoding="utf-8")):
            yield f"{path.relative_to(out)}: loads from another host"


def built(python, found, out):
    """Builds the site; faults as lines."""
    settings = TARGET / "mkdocs.yml"
    nav = json.dumps([{heading: entries} for heading, entries in found.items()], ensure_ascii=False)
    settings.write_text(CONFIGURATION.format(pages=json.dumps(str(PAGES)), out=json.dumps(str(out)), nav=nav))
    done = subprocess.run(
        [python, "-m", "mkdocs", "build", "--strict", "--clean", "--config-file", settings],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )
    lines = [line for line in done.stdout.splitlines() if line.strip()]
    said = [line for line in lines if re.match(r"(WARNING|ERROR)", line)]
    return [] if done.returncode == 0 else said or lines[-20:]


def made(out):
    """Makes the site in a folder; its pages, and what is wrong."""
    python = prepared()
    stage = Stage()
    stage.run()
    if stage.faults:
        return stage.pages, stage.faults
    found = navigation(stage.pages)
    faults = built(python, found, out)
    if not faults:
        # Pages as text stand beside the others, for programs that read llms.txt.
        shutil.copytree(PAGES, out, dirs_exist_ok=True)
        (out / "llms.txt").write_text(list_of_pages(found, stage.pages), encoding="utf-8")
        faults = list(foreign(out))
    return stage.pages, faults


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=pathlib.Path, default=TARGET / "html")
    out = parser.parse_args().out.resolve()
    try:
        pages, faults = made(out)
    except environment.Unavailable as reason:
        print(f"SKIPPED: the site, its tools cannot be installed: {reason}")
        return
    if faults:
        sys.exit("\n".join([*faults, f"site: {len(faults)} faults"]))
    print(f"site: {len(pages)} pages in {out}; to read and search them: python3 -m http.server --directory {out} 8000")


if __name__ == "__main__":
    main()
