"""Tables between the marks of a Markdown document, so that no number is copied by hand.

<!-- table: NAME -->
...
<!-- end -->
"""

from __future__ import annotations

import re
from collections.abc import Mapping

_BLOCK = re.compile(
    r"(?P<head><!-- table: (?P<name>[\w-]+) -->\n)(?P<body>.*?)(?P<foot><!-- end -->)", re.DOTALL
)


def with_tables(text: str, tables: Mapping[str, str], where: str) -> str:
    """Return a document with its tables replaced; those that are not given stay as they are.

    Parameters
    ----------
    text : str
    tables : mapping
        Name to Markdown.
    where : str
        Names the document in errors.

    Raises
    ------
    ValueError
        If a table has no marks, or marks have no end.
    """
    places = [match["name"] for match in _BLOCK.finditer(text)]
    opened = re.findall(r"<!-- table: ([\w-]+) -->", text)
    if places != opened:
        unclosed = next(
            name for name in opened if name not in places or opened.count(name) > places.count(name)
        )
        raise ValueError(f"{where}: table '{unclosed}' has no end; expected a line <!-- end --> behind it")
    absent = [name for name in tables if name not in places]
    if absent:
        raise ValueError(f"{where}: no place for table '{absent[0]}'; expected <!-- table: {absent[0]} -->")

    def replaced(match: re.Match[str]) -> str:
        table = tables.get(match["name"])
        body = match["body"] if table is None else f"{table}\n"
        return f"{match['head']}{body}{match['foot']}"

    return _BLOCK.sub(replaced, text)
