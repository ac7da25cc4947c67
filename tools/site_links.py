"""A hook of mkdocs: links that lead out of docs/ into the project.

They are kept for readers of the project. On the site they become links into its repository, once mkdocs.yml names one
(`repo_url`), else their words alone. One that leads nowhere ends the build.
"""

import re
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError

ROOT = Path(__file__).resolve().parents[1]
_OUTWARD = re.compile(
    r"(?<!!)\[(?P<words>(?:[^\[\]]|\[[^\]]*\])+)\]\((?P<target>(?:\.\./)+[^)\s#]+)(?P<anchor>#[^)]*)?\)"
)


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Any) -> str:
    """The page with these links replaced; called by mkdocs for each page."""
    folder = (ROOT / "docs" / page.file.src_uri).parent

    def replace(link: re.Match[str]) -> str:
        target = (folder / link["target"]).resolve()
        if target.is_relative_to(ROOT / "docs"):
            return link[0]
        if not target.exists():
            raise PluginError(f"{page.file.src_uri}: {link['target']} leads nowhere")
        if not config.repo_url:
            return link["words"]
        kind = "tree" if target.is_dir() else "blob"
        return f"[{link['words']}]({config.repo_url.rstrip('/')}/{kind}/HEAD/{target.relative_to(ROOT).as_posix()})"

    return _OUTWARD.sub(replace, markdown)
