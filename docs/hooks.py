"""Hooks of the site: notebooks become pages, formulas become MathML, and the table of commands follows the program."""

import html
import re
from pathlib import PurePosixPath

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from mkdocs.utils import get_relative_url
from nbconvert import MarkdownExporter

from training.cli import GROUPS

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
COMMANDS = "<!-- commands -->"
SEARCH = 'data-md-component="search" role="dialog"'
SEARCH_SCRIPT = "https://unpkg.com/iframe-worker/shim"  # for searching without a server, that the theme would load
SCRIPT = "javascripts/iframe-worker.js"  # in its place


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Replace each notebook by a Markdown page with its stored outputs."""
    for file in [file for file in files if file.src_uri.endswith(".ipynb")]:
        path = PurePosixPath(file.src_uri)
        names = {"unique_key": path.stem, "output_files_dir": f"{path.stem}-files"}
        text, resources = MarkdownExporter().from_filename(file.abs_src_path, names)
        files.remove(file)
        files.append(File.generated(config, str(path.with_suffix(".md")), content=text))
        for name, content in resources["outputs"].items():
            files.append(File.generated(config, str(path.parent / name), content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """List the commands by group, and lead links to notebooks to their pages."""
    return re.sub(r"\.ipynb([)#])", r".md\1", markdown.replace(COMMANDS, commands()))


def commands() -> str:
    """Return the commands by group as Markdown."""
    return "\n".join(
        "\n".join(
            [
                f"## {title.capitalize()}\n",
                "| command | what it does |",
                "|---|---|",
                *(_row(name, group[name][1]) for name in group),
            ]
        )
        + "\n"
        for title, group in GROUPS.items()
    )


def _row(name: str, summary: str) -> str:
    return f"| `sonar-gym {name}` | {summary} |"


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Typeset formulas, which then need neither a script nor the network; wide tables can be reached by keyboard."""
    content = content.replace('class="dataframe"', 'class="dataframe" tabindex="0"')
    return FORMULA.sub(lambda found: _mathml(found[1], html.unescape(found[2]).strip()), content)


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Let a page load nothing from elsewhere, and name the dialog of its search."""
    return _alone(output, get_relative_url(SCRIPT, page.url))


def on_post_template(output: str, template_name: str, config: MkDocsConfig) -> str:
    """Do the same with the page for what is not found."""
    return _alone(output, f"/{SCRIPT}")


def _alone(output: str, script: str) -> str:
    return output.replace(f"{SEARCH}>", f'{SEARCH} aria-label="Search">').replace(SEARCH_SCRIPT, script)


def _mathml(tag: str, latex: str) -> str:
    if tag == "span":
        return convert(latex)
    return (
        f'<div class="formula" tabindex="0" role="group" aria-label="formula">{convert(latex, display="block")}</div>'
    )
