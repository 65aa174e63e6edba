# Choosing the Python for the environment. Sourced by scripts/setup after common.sh.

# Prints "major.minor headers venv" of an interpreter, e.g. "3.11 yes yes"; fails if it does not run.
# Written for Python 2.7 up, so that an old one is told apart from a broken one.
probe_python() {
  "$1" -c '
import os, sys, sysconfig
plain = sys.version.find("PyPy") < 0 and not sysconfig.get_config_var("Py_GIL_DISABLED")
headers = os.path.isfile(os.path.join(sysconfig.get_path("include"), "Python.h"))
try:
    import ensurepip, venv
    venv = True
except ImportError:
    venv = False
words = {True: "yes", False: "no"}
print("%d.%d %s %s" % (sys.version_info[0], sys.version_info[1] if plain else -1, words[headers], words[venv]))
' 2>/dev/null
}

# What versions will do, in words: a ROS 2 from apt is made for one, the wheels exist for four.
supported_versions() {
  if [ "$(ros_source)" = apt ]; then
    basename -a "$APT_ROS"/lib/python3.* | sed 's/^python//' | paste -sd ' '
  else
    echo "3.10 3.11 3.12 3.13"
  fi
}

# Says why an interpreter will not do, or nothing if it will.
python_problem() {
  local version headers venv supported
  read -r version headers venv < <(probe_python "$1") || { echo "does not run"; return; }
  supported="$(supported_versions)"
  if [[ " $supported " != *" $version "* ]]; then
    echo "is Python $version; needed is CPython $supported"
  elif [ "$venv" = no ]; then
    echo "has no venv module; install it (Debian, Ubuntu: sudo apt install python$version-venv)"
  elif [ "$headers" = no ]; then
    echo "has no header files; install them (Debian, Ubuntu: sudo apt install python$version-dev)"
  fi
}

# The interpreters to try, best first: the one of before, Jazzy's own version, the others.
python_candidates() {
  local version
  if [ -f "$ENV_STAMP" ]; then sed -n 2p "$ENV_STAMP"; fi
  for version in 3.12 $(supported_versions | tr ' ' '\n' | sort -rV); do echo "python$version"; done
  printf '%s\n' python3 python
}

# Sets PYTHON to a fitting interpreter, or ends with one line that says what to install.
choose_python() {
  local candidate problem first=""
  if [ -n "${QUADFTC_PYTHON:-}" ]; then
    PYTHON="$(path_of "$QUADFTC_PYTHON")" || die 2 "QUADFTC_PYTHON=$QUADFTC_PYTHON is not there"
    problem="$(python_problem "$PYTHON")"
    [ -z "$problem" ] || die 2 "QUADFTC_PYTHON=$QUADFTC_PYTHON $problem"
    return
  fi
  while read -r candidate; do
    PYTHON="$(path_of "$candidate")" || continue
    problem="$(python_problem "$PYTHON")"
    [ -n "$problem" ] || return 0
    case $problem in "does not run" | "is Python"*) ;; *) first="${first:-$PYTHON $problem}" ;; esac
  done < <(python_candidates)
  [ -z "$first" ] || die 2 "$first"
  die 2 "found no CPython of $(supported_versions); install one (Debian, Ubuntu: sudo apt install python3 python3-venv python3-dev)" \
    "or name one with QUADFTC_PYTHON=/path/to/python"
}
