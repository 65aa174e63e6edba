"""Where recorded logs are, beside the repository; tests of them are left out where there are none."""

from __future__ import annotations

from pathlib import Path

import pytest

DATA = next(
    (each / "shared/data" for each in Path(__file__).resolve().parents if (each / "shared/data").is_dir()),
    Path("/no shared data"),
)
needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason="no recorded logs beside the repository (shared/data)"
)
