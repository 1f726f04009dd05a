#!/usr/bin/env bash
# The page of splinemap-viewer, in a browser beside a daemon: what it shows is what the map says.
if [[ ${2:-} != inside ]]; then
  if ! command -v splinemap-viewer > /dev/null; then
    echo "viewer: skipped, splinemap-viewer was not built"
    exit 0
  fi
  # Inside there is no network.
  for folder in "$1/tests/browser" "$1/clients/viewer"; do
    [[ $folder/node_modules/.package-lock.json -nt $folder/package-lock.json ]] ||
      npm ci --prefix "$folder" --no-audit --no-fund --loglevel=error || exit 1
  done
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

"$top/clients/viewer/node_modules/.bin/tsc" -p "$top/clients/viewer" --noEmit > tsc.log &
types=$!
splinemap simulate office.lcmlog 2> /dev/null
expect 0 node --test "$top/tests/browser/viewer_test.mjs"
grep -o "viewer: .*" out
wait "$types" || fail "types of clients/viewer: $(cat tsc.log)"
