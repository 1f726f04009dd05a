#!/usr/bin/env bash
# Drives played by lcm-logplayer into splinemapd on a bus of their own give the map of the offline build.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

# replay LOG SPEED SIGNAL FLAGS..: leaves live.splinemap and its last status in status.json.
replay() {
  local log=$1 speed=$2 signal=$3 messages
  shift 3
  rm -f live.splinemap offline.splinemap
  splinemap doctor "$log" --json "$@" > log.json
  messages=$(jq '(.scans + [.pose]) as $c | [.channels[] | select(.name | IN($c[])) | .messages] | add' \
    log.json)
  splinemapd --map live.splinemap --name robot "$@" 2> daemon.log &
  local daemon=$!
  await splinemap watch --once --timeout 2
  lcm-logplayer -s "$speed" "$log" > /dev/null
  # shellcheck disable=SC2016
  await bash -c 'splinemap watch --once --json --timeout 2 > status.json &&
    (($(jq .messages_received status.json) >= $1))' _ "$messages"
  kill -s "$signal" "$daemon"
  wait "$daemon" || fail "the daemon's exit status on $signal; $(cat daemon.log)"
  [[ $(jq .messages_received status.json) == "$messages" ]] || fail "received: $(cat status.json)"
  [[ $(ls live.splinemap*) == live.splinemap ]] || fail "more than one file: $(ls live.splinemap*)"
}

same_as_offline() {
  expect 0 splinemap build "$1" offline.splinemap --name robot "${@:2}"
  expect 0 splinemap diff live.splinemap offline.splinemap
  echo "$(basename "$1"): $(cat out)"
}

splinemap simulate office.lcmlog 2> /dev/null
replay office.lcmlog 20 TERM --scan LASER --pose POSE
same_as_offline office.lcmlog --scan LASER --pose POSE
[[ $(jq '.scans_mapped > 1600 and .dropped == {} and .last_problem == ""' status.json) == true ]] ||
  fail "status: $(cat status.json)"

# Once more into the same file: the second life goes on with the map.
cp live.splinemap first.splinemap
splinemapd --map live.splinemap --name robot --scan LASER --pose POSE 2> daemon.log &
daemon=$!
await splinemap watch --once --timeout 2
kill -INT "$daemon"
wait "$daemon" || fail "the second life failed: $(cat daemon.log)"
expect 0 splinemap diff live.splinemap first.splinemap
expect 0 splinemap info live.splinemap --json
[[ $(jq '.layers[0].session_number' out) == 2 ]] || fail "session_number: $(cat out)"

# What lcm-logger records of the daemon is LCM that others read.
splinemapd --map log.splinemap --scan LASER --pose POSE 2> daemon.log &
daemon=$!
await splinemap watch --once --timeout 2
lcm-logger --quiet --force recorded.lcmlog &
logger=$!
sleep 1
await splinemap watch --once --timeout 2  # has the daemon say its state
sleep 1
kill -INT "$logger"
wait "$logger" || true
kill "$daemon"
wait "$daemon" || fail "the daemon: $(cat daemon.log)"
expect 1 splinemap doctor recorded.lcmlog --json --scan A --pose B  # lists, and proposes nothing
[[ $(jq -r '.channels[] | select(.name == "SPLINEMAP_STATUS") | .type' out) == splinemap.status_t ]] ||
  fail "recorded: $(cat out)"

# Silence is said.
expect 1 splinemap watch --timeout 0.5
expect_text "nothing was received on SPLINEMAP_STATUS" err

if [[ ! -d $shared_data ]]; then
  echo "live_replay: recorded drives skipped, the shared data folder is not there"
  exit 0
fi
splinemap import-carmen "$shared_data/carmen/intel-corrected.log.gz" intel.lcmlog 2> /dev/null
replay intel.lcmlog 400 TERM --scan LASER --pose POSE
same_as_offline intel.lcmlog --scan LASER --pose POSE
convex=(--scan RPLIDAR_LASER:michigan_2014 --pose SLAM_POSE)
replay "$shared_data/lcm/convex_arena.lcmlog" 10 INT "${convex[@]}"
same_as_offline "$shared_data/lcm/convex_arena.lcmlog" "${convex[@]}"
