"""Draw the packages and the imports between them, from the code, as a Mermaid diagram in a document.

    python -m quadftc_tools.docs.packages docs/architecture.md

An arrow that follows from others is left out (transitive reduction). What only nodes import is dotted.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import grimp

TOPIC = {
    "bags": "read, write, repair, play bags",
    "campaign": "batch engine, campaigns, tuning",
    "cli": "the command",
    "compile": "a law's step as C: traced, built, kept, run",
    "control": "controllers, references, flight manager",
    "fdi": "fault and disturbance observers",
    "flight": "scenario, closed loop, graph, metrics",
    "model": "rotations, rigid body, vehicles",
    "replay": "recorded IMU through the diagnosis",
    "report": "everything that draws",
    "ros": "node, topics, QoS, recorder",
    "sim": "plant, sensors, faults",
    "sitl": "a real autopilot's firmware in the loop",
    "theory": "where theorems hold",
}
MARKS = re.compile(r"(<!-- packages: begin[^\n]*-->\n).*?(<!-- packages: end -->)", re.S)


def package_imports() -> dict[str, dict[str, bool]]:
    """Return package -> imported package -> whether more than its nodes import it."""
    names = sorted(f"quadftc_{name}" for name in TOPIC)
    graph = grimp.build_graph(*names, cache_dir=None)
    found: dict[str, dict[str, bool]] = {name: {} for name in names}
    for module in graph.modules:
        user = module.partition(".")[0]
        is_node = module.endswith(("_node", "_output"))
        for imported in graph.find_modules_directly_imported_by(module):
            used = imported.partition(".")[0]
            if used != user:
                found[user][used] = found[user].get(used, False) or not is_node
    return found


def reduce_arrows(imports: dict[str, dict[str, bool]]) -> list[tuple[str, str, bool]]:
    """Leave out each arrow whose end can be reached by others."""

    def reaches(start: str, end: str) -> bool:
        return any(step == end or reaches(step, end) for step in imports[start])

    return [
        (user, used, solid)
        for user, others in sorted(imports.items())
        for used, solid in sorted(others.items())
        if not any(reaches(other, used) for other in others if other != used)
    ]


def draw() -> str:
    """Return the diagram."""
    lines = ["```mermaid", "flowchart BT"]
    for name, topic in TOPIC.items():
        lines.append(f'  {name}["<b>quadftc_{name}</b><br>{topic}"]')
    for user, used, solid in reduce_arrows(package_imports()):
        arrow = "-->" if solid else "-.->"
        lines.append(f"  {user.removeprefix('quadftc_')} {arrow} {used.removeprefix('quadftc_')}")
    return "\n".join([*lines, "```", ""])


def renew(text: str) -> str:
    """Put the diagram between its marks."""
    return MARKS.sub(lambda match: match[1] + draw() + match[2], text)


if __name__ == "__main__":
    document = Path(sys.argv[1])
    document.write_text(renew(document.read_text(encoding="utf-8")), encoding="utf-8")
