"""Repeats the attacks, one row of a table each; `python -m quadftc_tools.attack --help`."""

import sys

from quadftc_tools.attack.command import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
