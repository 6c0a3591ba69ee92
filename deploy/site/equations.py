"""Hook of MkDocs: typesets the equations of each page with KaTeX when the site is built, so that a page needs no script for them.

The extension Arithmatex marks `$...$` and blocks of ```math. build.py puts KaTeX into the folder `katex` beside the configuration.
The search omits equations, because it would list LaTeX. A page with an equation that GitHub or KaTeX does not show as written fails.
"""

import html
import json
import pathlib
import re
import subprocess

from mkdocs.exceptions import PluginError

HERE = pathlib.Path(__file__).resolve().parent
MARK = 'class="arithmatex"'
INLINE = re.compile(rf'(<span {MARK}[^>]*>)\\\((.*?)\\\)(</span>)', re.DOTALL)
DISPLAY = re.compile(rf'(<div {MARK}[^>]*>)\\\[\n(.*?)\n\\\](</div>)', re.DOTALL)
# Parts of an inline equation that the Markdown of GitHub may take for its own: an escape such as `\,`, emphasis, a tag, a line end. Display equations are
# blocks of code to it.
TAKEN = re.compile(r"\\[^A-Za-z\s]|(?<![A-Za-z0-9])_|[*~`|\n]|<\S")
# A macro that GitHub refuses.
REFUSED = re.compile(r"\\operatorname\b")


def on_page_content(content, page, **_):
    """Hides equations from the search, which reads the content now."""
    for kind in (INLINE, DISPLAY):
        for _, latex, _ in kind.findall(content):
            latex = html.unescape(latex)
            if found := REFUSED.search(latex) or (kind is INLINE and TAKEN.search(latex)):
                raise PluginError(f"{page.file.src_path}: GitHub may not show the equation {latex} because of {found[0]!r}")
    return content.replace(MARK, f"{MARK} data-search-exclude")


def on_post_page(output, page, config):
    """Puts the typeset equations in place of the LaTeX."""
    found = [(match, kind is DISPLAY) for kind in (INLINE, DISPLAY) for match in kind.finditer(output)]
    if len(found) != output.count(MARK):
        raise PluginError(f"{page.file.src_path}: {output.count(MARK)} equations, but {len(found)} were understood")
    if not found:
        return output
    katex = pathlib.Path(config.config_file_path).parent / "katex/node_modules/katex/dist/katex.mjs"
    equations = json.dumps([[html.unescape(match[2]), is_display] for match, is_display in found])
    ran = subprocess.run(["node", HERE / "equations.mjs", katex], input=equations, capture_output=True, text=True)
    if ran.returncode:
        raise PluginError(f"{page.file.src_path}: KaTeX cannot typeset an equation: {ran.stderr.strip()}")
    typeset = dict(zip((match[0] for match, _ in found), json.loads(ran.stdout), strict=True))

    def replaced(match):
        return match[1] + typeset[match[0]] + match[3]

    return DISPLAY.sub(replaced, INLINE.sub(replaced, output))
