"""Reports: figures and pages of flights, replays and campaigns."""
