"""Makes a clone ready for release: who, where and what has changed, from the command line into every file.

    python -m quadftc_tools.release --maintainer NAME --email ADDRESS --url URL [--version X.Y.Z]

It writes them into each package.xml and setup.py and into pyproject.toml; and a CHANGELOG.rst beside each
package.xml as bloom reads it (REP-132), from CHANGELOG.md. An address that nobody has is refused.
"""

from __future__ import annotations

import argparse
import datetime as dt
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape, quoteattr

NOBODY = re.compile(r"example|localhost|invalid|\btest\b|\btodo\b", re.IGNORECASE)
EMAIL = re.compile(r"[^@\s<>\"]+@[^@\s<>\"]+\.[a-zA-Z]{2,}")
URL = re.compile(r"https://[^\s/\"<>]+\.[^\s/\"<>]+/[^\s\"<>]+")
VERSION = re.compile(r"\d+\.\d+\.\d+")


class Release(NamedTuple):
    """What the files are to say."""

    maintainer: str
    email: str
    url: str  # of the repository
    version: str

    def problems(self) -> Iterator[str]:
        """Say what cannot be published."""
        for name, value, form in (
            ("maintainer", self.maintainer, re.compile(r"[^\"<>\n]+")),
            ("email", self.email, EMAIL),
            ("url", self.url, URL),
            ("version", self.version, VERSION),
        ):
            if not form.fullmatch(value):
                yield f"--{name} {value!r}: not of the form that package.xml takes"
            elif NOBODY.search(value) and name != "version":
                yield f"--{name} {value!r}: an example; expected the one who answers for the release"


def main(arguments: list[str]) -> int:
    """Write the files; return the exit code, 2 if something is refused."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    for name, words in (
        ("maintainer", "name"),
        ("email", "address"),
        ("url", "https address of the repository"),
    ):
        parser.add_argument(f"--{name}", required=True, help=words)
    parser.add_argument(
        "--root", type=Path, default=Path(__file__).parents[2], help="clone; default: this one"
    )
    parser.add_argument("--version", default="", help="default: as it is")
    given = parser.parse_args(arguments)
    root: Path = given.root
    present = re.search(r"<version>(.*)</version>", _read(root / "ros2_ws/src/quadftc_model/package.xml"))
    version = given.version or (present[1] if present else "")
    release = Release(given.maintainer, given.email, given.url.rstrip("/"), version)
    problems = [*release.problems()]
    notes = _notes(_read(root / "CHANGELOG.md"))
    if not notes:
        problems.append("CHANGELOG.md: nothing under 'Unreleased'")
    if problems:
        sys.stderr.writelines(f"release: {problem}\n" for problem in problems)
        return 2
    written = [*_write_all(root, release, notes)]
    left = [path for path in written if NOBODY.search(_addresses(_read(path)))]
    sys.stderr.writelines(f"release: {path}: an example address is left\n" for path in left)
    sys.stdout.write(f"{len(written)} files say {release.version}, {release.maintainer} <{release.email}>\n")
    return 2 if left else 0


def _write_all(root: Path, release: Release, notes: list[str]) -> Iterator[Path]:
    """Write every file; yield its path."""
    manifests = sorted(root.glob("ros2_ws/src/*/package.xml"))
    for file in (*manifests, *root.glob("examples/**/package.xml")):
        yield _replace(file, _manifest(_read(file), release))
    for file in sorted(root.glob("ros2_ws/src/*/setup.py")):
        yield _replace(file, _setup(_read(file), release))
    yield _replace(root / "pyproject.toml", _project(_read(root / "pyproject.toml"), release))
    for manifest in manifests:
        yield _replace(
            manifest.with_name("CHANGELOG.rst"), _changelog(manifest.parent.name, release.version, notes)
        )


def _manifest(text: str, release: Release) -> str:
    who = f"<maintainer email={quoteattr(release.email)}>{escape(release.maintainer)}</maintainer>"
    text = re.sub(r"<maintainer .*</maintainer>", lambda _: who, text)
    text = re.sub(r"<version>.*</version>", f"<version>{release.version}</version>", text)
    text = re.sub(r"\n *<url .*</url>", "", text)
    kinds = {"repository": release.url, "bugtracker": f"{release.url}/issues"}
    urls = "".join(f'\n  <url type="{kind}">{escape(url)}</url>' for kind, url in kinds.items())
    return re.sub(r"(</license>)", lambda end: end[1] + urls, text, count=1)


def _setup(text: str, release: Release) -> str:
    for name, value in (
        ("version", release.version),
        ("maintainer", release.maintainer),
        ("maintainer_email", release.email),
    ):
        text = re.sub(rf'\b{name}="[^"]*"', lambda _, n=name, v=value: f'{n}="{v}"', text)
    return text


def _project(text: str, release: Release) -> str:
    who = f'maintainers = [{{ name = "{release.maintainer}", email = "{release.email}" }}]'
    text = re.sub(r"^maintainers = .*$", lambda _: who, text, flags=re.MULTILINE)
    text = re.sub(r"\[project\.urls\]\n(?:.+\n)*\n", "", text)
    urls = f'[project.urls]\nRepository = "{release.url}"\nIssues = "{release.url}/issues"\n\n'
    return text.replace("[project.scripts]\n", f"{urls}[project.scripts]\n", 1)


def _notes(changelog: str) -> list[str]:
    """Return the entries under 'Unreleased', a line of reStructuredText each."""
    body = changelog.partition("\n## Unreleased\n")[2].partition("\n## ")[0]
    entries = re.findall(r"^- (.+(?:\n  .+)*)", body, flags=re.MULTILINE)
    return [_plain(" ".join(entry.split())) for entry in entries]


def _plain(text: str) -> str:
    """Turn Markdown into reStructuredText: literals doubled, links to their words, no other markup."""
    parts = re.split(r"(`[^`]*`)", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text))
    return "".join(
        f"``{part[1:-1].strip()}``" if part.startswith("`") else re.sub(r"([*\\_|])", r"\\\1", part)
        for part in parts
    )


def _changelog(package: str, version: str, notes: list[str]) -> str:
    title = f"Changelog for package {package}"
    today = dt.datetime.now(dt.timezone.utc).date()
    heading = f"{version} ({today})"
    lines = ["^" * len(title), title, "^" * len(title), "", heading, "-" * len(heading)]
    return "\n".join([*lines, *(f"* {note}" for note in notes), ""])


def _addresses(text: str) -> str:
    """Return the maintainers and URLs of a file, a line each."""
    return "\n".join(re.findall(r".*(?:maintainer|<url|Repository|Issues).*", text))


def _read(file: Path) -> str:
    return file.read_text(encoding="utf-8")


def _replace(file: Path, text: str) -> Path:
    file.write_text(text, encoding="utf-8")
    return file


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
