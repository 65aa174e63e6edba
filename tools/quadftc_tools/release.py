"""Makes a clone ready for release: who and where, from the command line into every file.

    python -m quadftc_tools.release --maintainer NAME --email ADDRESS --url URL [--version X.Y.Z]

It writes them into each package.xml and setup.py and into pyproject.toml. An address that nobody has is
refused. ``catkin_generate_changelog --all`` then writes the CHANGELOG.rst that bloom reads (REP-132).
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape, quoteattr

NOBODY = re.compile(r"example|localhost|invalid|\btest\b|\btodo\b", re.IGNORECASE)
FORMS = {  # of each argument
    "maintainer": r"[^\"<>\n]+",
    "email": r"[^@\s<>\"]+@[^@\s<>\"]+\.[a-zA-Z]{2,}",
    "url": r"https://[^\s/\"<>]+\.[^\s/\"<>]+/[^\s\"<>]+",
    "version": r"\d+\.\d+\.\d+",
}


class Release(NamedTuple):
    """What the files are to say."""

    maintainer: str
    email: str
    url: str  # of the repository
    version: str

    def problems(self) -> Iterator[str]:
        """Say what cannot be published."""
        for name, value in zip(self._fields, self, strict=True):
            if not re.fullmatch(FORMS[name], value):
                yield f"--{name} {value!r}: not of the form that package.xml takes"
            elif NOBODY.search(value) and name != "version":
                yield f"--{name} {value!r}: an example; expected the one who answers for the release"


def main(arguments: list[str]) -> int:
    """Write the files; return the exit code, 2 if something is refused."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--maintainer", required=True, help="name")
    parser.add_argument("--email", required=True, help="address")
    parser.add_argument("--url", required=True, help="https address of the repository")
    parser.add_argument("--root", type=Path, default=Path(__file__).parents[2], help="clone")
    parser.add_argument("--version", default="", help="default: as it is")
    given = parser.parse_args(arguments)
    root: Path = given.root
    present = re.search(r"<version>(.*)</version>", _read(root / "ros2_ws/src/quadftc_model/package.xml"))
    version = given.version or (present[1] if present else "")
    release = Release(given.maintainer, given.email, given.url.rstrip("/"), version)
    if problems := [*release.problems()]:
        sys.stderr.writelines(f"release: {problem}\n" for problem in problems)
        return 2
    written = [*_write_all(root, release)]
    left = [path for path in written if NOBODY.search(_addresses(_read(path)))]
    sys.stderr.writelines(f"release: {path}: an example address is left\n" for path in left)
    sys.stdout.write(f"{len(written)} files say {release.version}, {release.maintainer} <{release.email}>\n")
    return 2 if left else 0


def _write_all(root: Path, release: Release) -> Iterator[Path]:
    """Write every file; yield its path."""
    changes = {
        "ros2_ws/src/*/package.xml": _manifest,
        "examples/**/package.xml": _manifest,
        "ros2_ws/src/*/setup.py": _setup,
        "pyproject.toml": _project,
    }
    for pattern, change in changes.items():
        for file in sorted(root.glob(pattern)):
            file.write_text(change(_read(file), release), encoding="utf-8")
            yield file


def _manifest(text: str, release: Release) -> str:
    who = f"<maintainer email={quoteattr(release.email)}>{escape(release.maintainer)}</maintainer>"
    text = re.sub(r"<maintainer .*</maintainer>", lambda _: who, text)
    text = re.sub(r"<version>.*</version>", f"<version>{release.version}</version>", text)
    text = re.sub(r"\n *<url .*</url>", "", text)
    kinds = {"repository": release.url, "bugtracker": f"{release.url}/issues"}
    urls = "".join(f'\n  <url type="{kind}">{escape(url)}</url>' for kind, url in kinds.items())
    return re.sub(r"(</license>)", lambda end: end[1] + urls, text, count=1)


def _setup(text: str, release: Release) -> str:
    told = {"version": release.version, "maintainer": release.maintainer, "maintainer_email": release.email}
    for name, value in told.items():
        text = re.sub(rf'\b{name}="[^"]*"', lambda _, n=name, v=value: f'{n}="{v}"', text)
    return text


def _project(text: str, release: Release) -> str:
    who = f'maintainers = [{{ name = "{release.maintainer}", email = "{release.email}" }}]'
    text = re.sub(r"^maintainers = .*$", lambda _: who, text, flags=re.MULTILINE)
    text = re.sub(r"\[project\.urls\]\n(?:.+\n)*\n", "", text)
    urls = f'[project.urls]\nRepository = "{release.url}"\nIssues = "{release.url}/issues"\n\n'
    return text.replace("[project.scripts]\n", f"{urls}[project.scripts]\n", 1)


def _addresses(text: str) -> str:
    """Return the maintainers and URLs of a file, a line each."""
    return "\n".join(re.findall(r".*(?:maintainer|<url|Repository|Issues).*", text))


def _read(file: Path) -> str:
    return file.read_text(encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
