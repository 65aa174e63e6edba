"""The subcommands of ``quadftc``, one module each: arguments in, text out; the work is done elsewhere."""

GOOD, CHECK_FAILED, BAD_INPUT, INTERNAL, NOT_ENOUGH, INTERRUPTED = 0, 1, 2, 3, 4, 130  # exit codes
