"""The picture of the packages in docs/architecture.md shows the imports that there are."""

import re
from pathlib import Path

import grimp

DOCUMENT = Path(__file__).parents[1] / "docs" / "architecture.md"
BOX, ARROW = (
    re.compile(r'^  (\w+)\["', re.MULTILINE),
    re.compile(r"^  (\w+) (-->|-\.->) (\w+)$", re.MULTILINE),
)


def imports_of(names):
    """Package -> imported package -> whether more than its nodes import it."""
    graph = grimp.build_graph(*(f"quadftc_{name}" for name in names), cache_dir=None)
    found = {name: {} for name in names}
    for module in graph.modules:
        user = module.partition(".")[0].removeprefix("quadftc_")
        is_node = module.endswith(("_node", "_output"))
        for imported in graph.find_modules_directly_imported_by(module):
            used = imported.partition(".")[0].removeprefix("quadftc_")
            if used != user:
                found[user][used] = found[user].get(used, False) or not is_node
    return found


def test_arrows_are_the_imports_that_do_not_follow_from_others():
    """An arrow means "imports"; a dotted one is used by nodes alone."""
    picture = DOCUMENT.read_text(encoding="utf-8").partition("flowchart BT")[2].partition("```")[0]
    imports = imports_of(BOX.findall(picture))

    def reaches(start, end):
        return any(step == end or reaches(step, end) for step in imports[start])

    expected = {
        (user, "-->" if solid else "-.->", used)
        for user, others in imports.items()
        for used, solid in others.items()
        if not any(reaches(other, used) for other in others if other != used)
    }
    assert set(ARROW.findall(picture)) == expected
