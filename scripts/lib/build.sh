# Building ros2_ws. Sourced by scripts/setup after common.sh.

# Environment of a build: this machine's variables, less those of any other ROS 2, plus ours.
enter_ros() {
  unset PYTHONPATH PYTHONHOME LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE \
    AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH
  if [ "$(ros_source)" = apt ]; then
    set +u
    . "$APT_ROS/setup.bash"
    set -u
  else
    export AMENT_PREFIX_PATH="$VENV" CMAKE_PREFIX_PATH="$VENV" ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3
    # The wheels restart each Python once to set these two; setting both here saves that.
    LD_LIBRARY_PATH="$VENV/lib$(printf ':%s' "$VENV"/lib/python3.*/site-packages/ros_*.libs)"
    export LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
  fi
  export VIRTUAL_ENV="$VENV" PATH="$VENV/bin:$PATH"
}

# Options of colcon, also for a `colcon build` by hand.
write_colcon_defaults() {
  local cmake_args="\"-GNinja\", \"-DBUILD_TESTING=OFF\", \"-DCMAKE_BUILD_TYPE=Release\", \"-DPython3_EXECUTABLE=$VENV/bin/python\""
  if [ "$(ros_source)" = wheels ]; then
    cmake_args+=", \"-DCMAKE_PROJECT_INCLUDE=$WORKSPACE/colcon/drop_missing_includes.cmake\""
  fi
  cat >"$VENV/colcon_defaults.yaml" <<YAML
# Written by scripts/setup.
build:
  symlink-install: true
  cmake-args: [$cmake_args]
YAML
}

# Writes what env.sh exports: every variable that entering ROS 2 and the workspace sets.
write_exports() {
  # shellcheck disable=SC2016
  env -i HOME="$HOME" PATH=/usr/bin:/bin QUADFTC_ROS="$APT_ROS" bash -c '
    set -eu
    . "$1/common.sh"; . "$1/build.sh"
    enter_ros
    set +u; . "$WORKSPACE/install/setup.bash"; set -u
    for name in $(compgen -e); do
      case $name in
        HOME | QUADFTC_ROS | PWD | OLDPWD | SHLVL | _) ;;
        PATH) printf "export PATH=%q\"\${PATH:+:\$PATH}\"\n" "${PATH%:/usr/bin:/bin}" ;;
        PYTHONPATH | LD_LIBRARY_PATH) value="${!name}"; printf "export %s=%q\"\${%s:+:\$%s}\"\n" $name "${value%:}" $name $name ;;
        *) printf "export %s=%q\n" "$name" "${!name}" ;;
      esac
    done' quadftc "$QUADFTC_ROOT/scripts/lib" >"$EXPORTS.new"
  mv "$EXPORTS.new" "$EXPORTS"
}

build_packages() {
  (enter_ros && cd "$WORKSPACE" && COLCON_DEFAULTS_FILE="$VENV/colcon_defaults.yaml" \
    python -m colcon --log-base log build --base-paths src --event-handlers console_direct- console_cohesion+)
}

# The laws of the demo and of `quadftc live`, from the sources: the build need not be there. In the background, as
# it takes this shell.
compile_laws() {
  if ! has_c_compiler; then
    say "no C compiler: laws fly in NumPy, which is slower; install one (Debian, Ubuntu: sudo apt install gcc)"
    exit 0
  fi
  enter_ros
  PYTHONPATH="$(printf '%s:' "$WORKSPACE"/src/quadftc_*)${PYTHONPATH:-}"
  export PYTHONPATH
  exec python -m quadftc_flight.recommended >"$LOG_DIR/laws.log" 2>&1
}

build_workspace() {
  local log="$LOG_DIR/build.log" inputs
  inputs="$(build_inputs)"
  # An unfinished build or one of another environment is not worth mending: all of it takes seconds.
  if [ "$(cat "$WORKSPACE/build/.quadftc-environment" 2>/dev/null)" != "$(<"$ENV_STAMP")" ]; then
    rm -rf "$WORKSPACE/build" "$WORKSPACE/install"
  fi
  mkdir -p "$WORKSPACE/build"
  rm -f "$BUILD_STAMP" "$WORKSPACE/build/.quadftc-environment"
  say "building ros2_ws (half a minute)"
  write_colcon_defaults
  if ! with_progress "$log" '^Finished <<<' "packages built" build_packages; then
    tail -n 30 "$log" >&2
    if grep -q "No space left on device" "$log"; then die 2 "the disk is full: make room"; fi
    die 3 "the build failed (whole log: $log)"
  fi
  write_exports
  cp "$ENV_STAMP" "$WORKSPACE/build/.quadftc-environment"
  echo "$inputs" >"$BUILD_STAMP"
}
