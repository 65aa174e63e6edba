# Making .venv. Sourced by scripts/setup after common.sh and python.sh.

DISK_NEEDED_KIB=$((2 * 1024 * 1024))  # 2 GiB: environment, build and pip's temporary files

check_machine() {
  if [ "$(ros_source)" = wheels ] && [ "$(uname -sm)" != "Linux x86_64" ]; then
    die 2 "this machine is $(uname -sm); ROS 2 wheels exist for Linux x86_64 only: install ROS 2 Jazzy in /opt/ros/jazzy"
  fi
  case $QUADFTC_ROOT in *[[:space:]]*) die 2 "the path $QUADFTC_ROOT has a blank in it, which CMake and colcon do not take: move the clone" ;; esac
}

check_compiler() {
  local compiler
  if [ -n "${CXX:-}" ]; then
    command -v "${CXX%% *}" >/dev/null || die 2 "there is no compiler CXX=$CXX"
    return
  fi
  for compiler in c++ g++ clang++; do
    if command -v "$compiler" >/dev/null; then return; fi
  done
  die 2 "no C++ compiler; install one (Debian, Ubuntu: sudo apt install g++)"
}

has_c_compiler() {
  local compiler
  for compiler in cc gcc clang; do
    if command -v "$compiler" >/dev/null; then return; fi
  done
  return 1
}

# What the workspace needs of a ROS 2 from apt.
check_apt_ros() {
  local package
  for package in ament_cmake rosidl_default_generators rclpy rmw_fastrtps_cpp diagnostic_msgs sensor_msgs std_srvs; do
    [ -d "$APT_ROS/share/$package" ] ||
      die 2 "$APT_ROS lacks $package; install it (Ubuntu: sudo apt install ros-jazzy-${package//_/-})"
  done
  command -v cmake >/dev/null || die 2 "no cmake; install it (Ubuntu: sudo apt install cmake)"
  (enter_ros && "$PYTHON" -c 'import numpy, rclpy, scipy') 2>/dev/null ||
    die 2 "$PYTHON has no NumPy, SciPy or rclpy; install them" \
      "(Ubuntu: sudo apt install python3-numpy python3-scipy ros-jazzy-rclpy)"
}

check_disk() {
  local free
  free="$(df -Pk "$QUADFTC_ROOT" | awk 'NR == 2 {print $4}')"
  if [ "$free" -lt "$DISK_NEEDED_KIB" ]; then
    die 2 "$((free / 1024)) MiB free on the disk of $QUADFTC_ROOT; set-up needs $((DISK_NEEDED_KIB / 1024)) MiB: make room"
  fi
}

# What pip's output means, in one line.
explain_pip_failure() {
  local log="$1"
  if grep -qE 'No space left on device' "$log"; then
    echo "the disk is full: make room"
  elif grep -qE 'NewConnectionError|Temporary failure in name|Network is unreachable|ConnectTimeout|ProxyError|SSLError|ReadTimeout|Connection(Reset|Refused)?Error' "$log"; then
    echo "pip cannot reach its package index: connect to the network, or set pip's index or proxy"
  elif grep -qE 'HASHES? (DO|DOES) NOT MATCH|do not match the hashes' "$log"; then
    echo "a downloaded package is not the one the lock names: check pip's index and proxy"
  elif grep -qE 'No matching distribution found' "$log"; then
    echo "pip finds no $(sed -n 's/.*No matching distribution found for \([^ ]*\).*/\1/p' "$log" | tail -n 1) in its package index"
  else
    echo "pip failed"
  fi
}

run_pip() {
  local log="$LOG_DIR/pip.log"
  if ! with_progress "$log" '^Collecting ' "packages fetched" \
    "$VENV/bin/python" -m pip install --disable-pip-version-check --no-input --progress-bar off --no-compile \
    --require-hashes --no-deps "$@"; then
    die 2 "$(explain_pip_failure "$log") (details: $log)"
  fi
}

install_lock() {
  local lock first="$LOG_DIR/setuptools.txt"
  lock="$QUADFTC_ROOT/$(lock_file)"
  # empy alone has no wheel: it is built here, with the setuptools of the lock instead of one fetched unchecked.
  awk '/^setuptools==/ {on = 1} on {print; if (!/\\$/) exit}' "$lock" >"$first"
  run_pip --only-binary :all: -r "$first"
  run_pip --only-binary :all: --no-binary empy --no-build-isolation -r "$lock"
}

# A half-made or outdated environment is made anew; one that set-up did not make is left alone.
remove_old_environment() {
  rm -rf "$VENV.old"
  rmdir "$VENV" 2>/dev/null || true
  [ -e "$VENV" ] || return 0
  [ -f "$ENV_STAMP" ] || die 2 "$VENV was not made by scripts/setup: move it away, then call scripts/setup again"
  mv "$VENV" "$VENV.old"  # first the stamp out of the way, so that a break here can be mended
  rm -rf "$VENV.old"
}

make_environment() {
  local options=()
  choose_python
  if [ "$(ros_source)" = apt ]; then check_apt_ros; fi
  remove_old_environment
  check_disk
  say "making .venv with $(probe_python "$PYTHON" | sed 's/^/Python /; s/ .es.*//') ($PYTHON), ROS 2 from $(ros_source)"
  if [ "$(ros_source)" = apt ]; then options+=(--system-site-packages); fi
  mkdir -p "$VENV"
  printf '%s\n' unfinished "$PYTHON" >"$ENV_STAMP"
  env -u PYTHONPATH -u PYTHONHOME "$PYTHON" -m venv "${options[@]}" "$VENV" >"$LOG_DIR/venv.log" 2>&1 ||
    die 2 "$PYTHON cannot make an environment (details: $LOG_DIR/venv.log)"
  say "installing the locked packages (a minute or two)"
  (unset PYTHONPATH PYTHONHOME LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE && install_lock) || exit $?
  { environment_inputs && echo "$PYTHON"; } >"$ENV_STAMP.new" && mv "$ENV_STAMP.new" "$ENV_STAMP"
}
