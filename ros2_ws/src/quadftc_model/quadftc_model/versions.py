"""The version of this software, whether a wheel or a workspace installed it."""

from __future__ import annotations


def software_version() -> str:
    """Return the version of the wheel, else of the workspace's packages, which share one."""
    from importlib.metadata import PackageNotFoundError, version  # takes long to import

    try:
        return version("quadftc-model")
    except PackageNotFoundError:
        return version("quadftc")
