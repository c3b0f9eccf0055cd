"""Make the links of a page lead to a tag on GitHub, since PyPI shows the page alone.

python .github/links.py README.md https://github.com/OWNER/occmap v0.2.0
"""

import re
import sys
from pathlib import Path

LINK = re.compile(r"(!?)\[([^\]]*)\]\((?![a-z]+:|#)([^)]+)\)")


def link_to(text: str, home: str, tag: str) -> str:
    """Replace links to files of the project; a picture is linked as it is, a page as shown."""

    def replace(link: re.Match[str]) -> str:
        kind = "raw" if link[1] else "blob"
        return f"{link[1]}[{link[2]}]({home}/{kind}/{tag}/{link[3]})"

    return LINK.sub(replace, text)


if __name__ == "__main__":
    path, home, tag = sys.argv[1:]
    page = Path(path)
    page.write_text(link_to(page.read_text(encoding="utf-8"), home, tag), encoding="utf-8")
