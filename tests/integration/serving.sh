#!/usr/bin/env bash
# Followers of a daemon, on a bus of their own, end with its map byte for byte.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

splinemap simulate office.lcmlog 2> /dev/null
expect 1 splinemap snapshot none.splinemap --timeout 1
expect_text "no map was received on SPLINEMAP_DIGESTS in 1 s; is splinemapd on this bus?" err
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
lcm-logger --quiet --force --channel='SPLINEMAP_.*' recorded.lcmlog &
logger=$!
await grep -q SPLINEMAP_DIGESTS recorded.lcmlog  # of the empty map, to which all scans are added
lcm-logplayer -s 10 office.lcmlog > /dev/null &
player=$!
expect 0 splinemap snapshot growing.splinemap --timeout 30
wait "$player"
expect 0 splinemap snapshot whole.splinemap
expect_text "robot: " err
# A part, and a coarser level of it.
expect 0 splinemap snapshot part.splinemap --region=0,0,5,5
expect 0 splinemap export part.splinemap part --format csv --region 0,0,5,5
expect 0 splinemap export whole.splinemap whole --format csv --region 0,0,5,5
cmp part.csv whole.csv || fail "a part is not what the whole has there"
expect 2 splinemap snapshot part.splinemap --region 0,0,5,5
expect_text "part.splinemap exists; --force replaces it" err
expect 2 splinemap snapshot part.splinemap --region 0,0,5 --force
expect_text "X0,Y0,X1,Y1" err
expect 0 splinemap snapshot coarse.splinemap --level 3 --statistic max
[[ $(splinemap info coarse.splinemap --json | jq .knot_interval_m) == 0.4 ]] || fail "not level 3"
expect 2 splinemap snapshot coarse.splinemap --statistic max --force
expect_text "--statistic max requires a --level above 0" err
kill -INT "$logger"
wait "$logger" || true

# The log alone has the map, from the first commit on.
expect 0 splinemap snapshot logged.splinemap --log recorded.lcmlog
expect 0 splinemap diff whole.splinemap logged.splinemap
expect 1 splinemap snapshot none.splinemap --log office.lcmlog
expect_text "SPLINEMAP_DIGESTS has no messages" err

# Its own messages from a log change nothing.
lcm-logplayer -s 50 --regexp='SPLINEMAP_.*' recorded.lcmlog > /dev/null
expect 0 splinemap snapshot again.splinemap
end_daemon
expect 0 splinemap diff live.splinemap whole.splinemap
expect 0 splinemap diff live.splinemap again.splinemap
expect 0 splinemap info growing.splinemap

# The next session of the daemon has the same map. Replayed messages of the last one do no harm.
start_daemon
expect 0 splinemap snapshot next.splinemap
lcm-logplayer -s 50 --regexp='SPLINEMAP_.*' recorded.lcmlog > /dev/null
await bash -c "splinemap watch --once --json | jq -e '.problems.shared_identity > 0'"
expect 0 splinemap snapshot again.splinemap --force
grep -q "an earlier session of robot is on the bus" daemon.log || fail "the daemon: $(cat daemon.log)"

# A second daemon with a copy of its map file, which is in a later session: the first continues as another
# layer, with all that it had.
cp next.splinemap copied.splinemap
splinemapd --map copied.splinemap --name robot --scan A --pose B 2> copied.log &
copied=$!
await grep -q "continues as another layer, origin" daemon.log
expect 0 splinemap snapshot both.splinemap
kill "$copied"
wait "$copied" || fail "the daemon of the copy: $(cat copied.log)"
[[ $(splinemap info both.splinemap --json | jq '.layers | length') == 2 ]] || fail "not two layers"
end_daemon
[[ $(splinemap info live.splinemap --json | jq -r '.layers[0].origin') != \
  $(splinemap info copied.splinemap --json | jq -r '.layers[0].origin') ]] || fail "one origin"
expect 0 splinemap render live.splinemap live.png
expect 0 splinemap render next.splinemap next.png
cmp live.png next.png || fail "the layer lost something on its way to another origin"

# A daemon that begins again from an older copy of its file, while a follower knows later sessions.
restore_copy() {
  rm -f live.splinemap*
  cp next.splinemap live.splinemap
}
restore_copy
start_daemon
end_daemon
start_daemon
splinemap snapshot waiting.splinemap --robot robot --robot nobody --timeout 120 2> /dev/null &
follower=$!
sleep 5  # until it believes in the session
kill -9 "$daemon"
wait "$daemon" 2> /dev/null || true
restore_copy
start_daemon
await grep -q "is an older copy. It continues as session" daemon.log
expect 0 splinemap snapshot again.splinemap --force
expect 0 splinemap diff next.splinemap again.splinemap
kill "$follower"
end_daemon
echo "serving: $(splinemap info next.splinemap | head -n 3)"
