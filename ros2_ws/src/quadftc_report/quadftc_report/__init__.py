"""Reports: figures and pages of flights, replays and campaigns."""

from pathlib import Path

DATA = Path(__file__).parent / "data"  # texts and tables that the modules read
