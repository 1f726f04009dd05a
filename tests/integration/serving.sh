#!/usr/bin/env bash
# Followers of a daemon, on a bus of their own, end with its map byte for byte.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

splinemap simulate office.lcmlog 2> /dev/null
expect 1 splinemap snapshot none.splinemap --timeout 1
expect_text "heard no map on SPLINEMAP_DIGESTS for 1 s; does splinemapd run on this bus?" err
[[ ! -e none.splinemap ]] || fail "a snapshot of nothing"

start_daemon() {
  splinemapd --map live.splinemap --name robot --scan LASER --pose POSE 2> daemon.log &
  daemon=$!
  await splinemap watch --once --timeout 2
}
end_daemon() {
  kill "$daemon"
  wait "$daemon" || fail "the daemon: $(cat daemon.log)"
}

# A follower that comes while the map grows, and one after that; what is recorded in the meantime.
start_daemon
lcm-logger --quiet --force recorded.lcmlog &
logger=$!
lcm-logplayer -s 20 office.lcmlog > /dev/null &
player=$!
expect 0 splinemap snapshot growing.splinemap --timeout 30
wait "$player"
expect 0 splinemap snapshot whole.splinemap
expect_text "robot: " err
kill -INT "$logger"
wait "$logger" || true

# Its own messages from a log change nothing.
lcm-logplayer -s 50 --regexp='SPLINEMAP_.*' recorded.lcmlog > /dev/null
expect 0 splinemap snapshot again.splinemap
end_daemon
expect 0 splinemap diff live.splinemap whole.splinemap
expect 0 splinemap diff live.splinemap again.splinemap
expect 0 splinemap info growing.splinemap

# The next life of the daemon has the same map, which nobody needs to be sent again.
start_daemon
expect 0 splinemap snapshot next.splinemap
end_daemon
expect 0 splinemap diff live.splinemap next.splinemap
echo "serving: $(splinemap info next.splinemap | head -n 3)"
