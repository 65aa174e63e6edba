"""A local page on which flight logs are judged: drop a log, read the verdict (`quadftc serve`)."""
