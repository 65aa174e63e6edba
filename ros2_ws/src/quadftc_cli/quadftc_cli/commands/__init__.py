"""The subcommands of ``quadftc``, one module each: arguments in, text out; the work is done elsewhere."""

GOOD, CHECK_FAILED, BAD_INPUT, INTERNAL, NOT_ENOUGH, INTERRUPTED = 0, 1, 2, 3, 4, 130  # exit codes

# names of the subcommands, and module:function below this package; those of other packages are entry points
_SAME = "run inject watch live new export replay diagnose serve repair report campaign tune check doctor sitl"
_OTHERS = {"clear": "inject:clear", "list": "catalogue:list_", "set": "set:set_"}
OWN = {name: f"{name}:{name}" for name in _SAME.split()} | _OTHERS
