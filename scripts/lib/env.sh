# Puts a shell into the environment that scripts/setup made:  . scripts/lib/env.sh
# Sourced by bash; a second time does nothing. Afterwards `quadftc`, `python`, `colcon` (in ros2_ws) and the nodes in
# ros2_ws/install/<package>/lib/<package>/ work, and ROS 2 stays on this machine unless you say otherwise.

quadftc_enter() {
  local root exports
  root="$(CDPATH='' cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd -P)"
  exports="$root/ros2_ws/install/quadftc_env.sh"
  if [ ! -f "$exports" ]; then
    echo "env.sh: nothing to enter yet: call scripts/setup first" >&2
    return 2
  fi
  case ":${AMENT_PREFIX_PATH:-}:" in
    *":$root/ros2_ws/install/"*) ;;  # already in, perhaps with a workspace of the user's on top
    *)
      quadftc_leave_other_ros PYTHONPATH
      quadftc_leave_other_ros LD_LIBRARY_PATH
      . "$exports"
      PATH="$root/ros2_ws/install/quadftc_cli/lib/quadftc_cli:$PATH"
      PYTHONPATH="$root/tools:$PYTHONPATH"  # not installed: benchmarks, studies, long tests
      ;;
  esac
  export COLCON_DEFAULTS_FILE="$root/.venv/colcon_defaults.yaml"
  quadftc_stay_local "$root/ros2_ws/src/quadftc_ros/quadftc_ros/loopback.xml"
}

# Binds Fast DDS to the loopback by a profile $1, unless a range is set: as quadftc_ros.reach, which says more.
quadftc_stay_local() {
  [ -z "${ROS_AUTOMATIC_DISCOVERY_RANGE:-}" ] || return 0
  case "${RMW_IMPLEMENTATION:-rmw_fastrtps_cpp}:${FASTRTPS_DEFAULT_PROFILES_FILE:-}" in
    rmw_fastrtps*: | rmw_fastrtps*:"$1")
      export ROS_AUTOMATIC_DISCOVERY_RANGE=SYSTEM_DEFAULT FASTRTPS_DEFAULT_PROFILES_FILE="$1"
      ;;
    *) export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ;;
  esac
}

# Drops from the path list named $1 what another sourced ROS 2 put there.
quadftc_leave_other_ros() {
  local entry prefix kept="" entries prefixes
  IFS=: read -ra entries <<<"${!1:-}"
  IFS=: read -ra prefixes <<<"${AMENT_PREFIX_PATH:-}"
  for entry in "${entries[@]}"; do
    for prefix in "${prefixes[@]}"; do
      case $entry in "$prefix" | "$prefix"/*) continue 2 ;; esac
    done
    kept+="${kept:+:}$entry"
  done
  export "$1=$kept"
}

quadftc_enter
