"""The page of ``quadftc live``: a process of its own, which shows a flight and has a say in it."""
