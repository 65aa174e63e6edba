"""Launch files, parameter files and the Foxglove layout (installed under ``share``)."""
