"""The subcommands of ``quadftc``, one module each: arguments in, text out; the work is done elsewhere."""

GOOD, CHECK_FAILED, BAD_INPUT, INTERNAL, INTERRUPTED = 0, 1, 2, 3, 130  # exit codes
