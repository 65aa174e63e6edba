# A browser for the test of the report. Sourced by scripts/test, before the environment is entered; only defines things.

BROWSER_PATIENCE=300  # s; how long apt may take

have_browser() {
  local name
  command -v chromedriver >/dev/null || return 1
  for name in chromium chromium-browser google-chrome; do
    if command -v "$name" >/dev/null; then return 0; fi
  done
  return 1
}

# Without any font, text is drawn as boxes.
have_fonts() { [ -n "$(find /usr/share/fonts /usr/local/share/fonts -name '*.[to]tf' -print -quit 2>/dev/null)" ]; }

# With CI=true, installs Chromium, its driver and a font where they are missing. Elsewhere installs nothing.
# Never fatal: without a browser the test is skipped, and says so.
provide_browser() {
  local packages=() as_root=() log="${TMPDIR:-/tmp}/quadftc_browser.$$.log"
  have_browser || packages+=(chromium chromium-driver)
  have_fonts || packages+=(fonts-dejavu-core)
  [ ${#packages[@]} -gt 0 ] || return 0
  if [ "${CI:-}" != true ]; then
    echo "test: no ${packages[*]}: the report is not tested in a browser (Debian, Ubuntu: sudo apt install ${packages[*]})" >&2
    return 0
  fi
  if ! command -v apt-get >/dev/null; then
    echo "test: no ${packages[*]}, and no apt-get to install it: the report is not tested in a browser" >&2
    return 0
  fi
  [ "$(id -u)" = 0 ] || as_root=(sudo -n)
  echo "test: installing ${packages[*]} for the test of the report (up to $((BROWSER_PATIENCE / 60)) minutes)" >&2
  # shellcheck disable=SC2016
  if "${as_root[@]}" timeout "$BROWSER_PATIENCE" env DEBIAN_FRONTEND=noninteractive sh -c \
    'apt-get -q update && apt-get -qy install --no-install-recommends "$@"' sh "${packages[@]}" >"$log" 2>&1; then
    rm -f "$log"
  else
    echo "test: could not install ${packages[*]}: $(grep -m 1 -E '^(E|Err):' "$log" || tail -n 1 "$log") (whole log: $log)" >&2
  fi
}
