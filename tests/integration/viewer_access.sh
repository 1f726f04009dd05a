#!/usr/bin/env bash
# splinemap-viewer answers who may ask, and nobody else; what comes in is bounded in size, number and time;
# what pages are sent is where it is in the map.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

if ! command -v splinemap-viewer > /dev/null; then
  echo "viewer_access: skipped, splinemap-viewer was not built"
  exit 0
fi
lcm-gen -p "$top"/lcmtypes/michigan/pose_xyt_t.lcm
echo "wall { x0_m: 5 y0_m: -5 x1_m: 5 y1_m: 9 } waypoint { x_m: 0 } waypoint { x_m: 3 y_m: 6.5 }" > room.world
splinemap simulate room.world room.lcmlog 2> /dev/null
# Without scans it is placed where it is read.
printf 'service { max_archive_mb: 0 }\n' > without_scans.textproto
splinemap build room.lcmlog room.splinemap --name robot --config without_scans.textproto 2> /dev/null
openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=localhost \
  -addext subjectAltName=IP:127.0.0.1 -keyout key.pem -out cert.pem 2> /dev/null
PYTHONPATH=$work:$top/tests/support python3 -m unittest --failfast viewer_access 2> out || fail "$(cat out)"
grep "^viewer_access: " out
tail -3 out | grep "^Ran" | sed 's/^/viewer_access: /'
