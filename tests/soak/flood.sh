#!/usr/bin/env bash
# flood.sh [--seconds N] [--rate N] [LOG]: replays a drive at its own speed into splinemapd, with N
# messages a second beside it that must not change the map, and prints what became of them. Fails where
# the numbers do not add up, where a loss is not said, where the map is not that of the quiet build
# although nothing was lost, or where memory grows. Without LOG, a bot_core log, it simulates one.
# `tests/soak/flood.sh` alone is the full run: 60 s of 20,000/s.
if [[ -z ${LCM_DEFAULT_URL:-} || ${1:-} != inside ]]; then
  top=$(cd "$(dirname "$(readlink -f "$0")")/../.." && pwd -P)
  dev=$top/build/dev
  command -v flood > /dev/null ||
    export PATH=$dev/clients/splinemap:$dev/services/splinemapd:$dev/tests:$PATH
  exec "$top/deploy/own_bus.sh" "$0" inside "$top" "$PWD" "$@"
fi
folder=$3
arguments=("${@:4}")
# shellcheck source=tests/integration/support.sh
source "$2/tests/integration/support.sh" "$2"

seconds=60
rate=20000
log=
set -- "${arguments[@]}"
while (($#)); do
  case $1 in
    --seconds) seconds=$2; shift ;;
    --rate) rate=$2; shift ;;
    -*) fail "unknown option $1" ;;
    *) log=$(cd "$folder" && realpath "$1") ;;
  esac
  shift
done

if [[ -z $log ]]; then
  log=$work/drive.lcmlog
  world=()  # of some minutes
  if ((seconds < 30)); then
    world=(short.world)
    cat > short.world << 'EOT'
wall { x0_m: -3 y0_m: -2 x1_m: 5 y1_m: -2 }
wall { x0_m: 5 y0_m: -2 x1_m: 5 y1_m: 4 }
wall { x0_m: 5 y0_m: 4 x1_m: -3 y1_m: 2 }
waypoint { x_m: 0 } waypoint { x_m: 3 y_m: 1 } waypoint { x_m: 3 y_m: 2 } waypoint { x_m: 0 }
EOT
  fi
  splinemap simulate "${world[@]}" "$log" 2> /dev/null
fi
inputs=(--scan LASER --pose POSE)
expect 0 splinemap build "$log" quiet.splinemap --name robot "${inputs[@]}"

splinemapd --map live.splinemap --name robot "${inputs[@]}" 2> daemon.log &
daemon=$!
await splinemap watch --once --timeout 2

# Datagrams that the kernel dropped because the socket of the process was full.
socket_drops() {
  local inodes
  inodes=$(find "/proc/$1/fd" -lname 'socket:*' -printf '%l\n' | tr -dc '0-9\n')
  awk 'NR == FNR { ours[$1]; next } $10 in ours { drops += $13 } END { print drops + 0 }' \
    <(echo "$inodes") "/proc/$1/net/udp"
}
memory_kb() { awk '/^VmRSS/ { print $2 }' "/proc/$daemon/status"; }

lcm-logplayer "$log" > player.log &
player=$!
flood --seconds "$seconds" --rate "$rate" > flood.json 2> flood.err &
flood=$!
# Daemons that start within the flood: liblcm reads from the moment that its socket is bound.
printf 'channel_prefix: "SECOND"\n' > second.textproto
for _ in {1..3}; do
  splinemapd --config second.textproto --map second.splinemap "${inputs[@]}" 2> second.log &
  second=$!
  await splinemap watch --prefix SECOND --once --timeout 2
  kill "$second"
  wait "$second" || fail "a daemon that started within the flood: $(cat second.log)"
done
while kill -0 "$flood" 2> /dev/null; do
  sleep 1
  memory_kb >> memory
done
wait "$flood" || fail "$(cat flood.err)"
wait "$player"

# All was received when nothing more is; meanwhile the queue empties.
settled() {
  local before=$received
  splinemap watch --once --json --timeout 2 > status.json
  received=$(jq .messages_received status.json)
  [[ $received == "$before" && $(jq .messages_queued status.json) == 0 ]]
}
received=
for _ in {1..60}; do settled && break; done
memory_kb >> memory
lost=$(socket_drops "$daemon")
kill "$daemon"
wait "$daemon" || fail "the daemon: $(cat daemon.log)"

messages=$(splinemap doctor "$log" --json "${inputs[@]}" |
  jq '[.channels[] | select(.name == "LASER" or .name == "POSE") | .messages] | add')
expected=$((messages + $(jq .sent_to_daemon flood.json)))
read -r least most < <(tail -n +3 memory | sort -n | sed -n '1p;$p' | xargs)
of() { jq "$1 // 0" status.json; }  # a number of the last status
overload=$(of .dropped.overload)
missing=$((expected - received))
jq -r '"sent \(.sent) messages in \(.seconds) s, \(.sent / .seconds | round) a second: \(.kinds)"' flood.json
echo "of them and the drive $expected on the daemon's channels: received $received, dropped by overload $overload"
echo "lost in the daemon's socket: $lost on any channel, $missing on the daemon's"
echo "dropped: $(jq -c .dropped status.json)"
echo "scans: $(jq -c '[.scans_received, .scans_mapped]' status.json) received and mapped"
echo "memory after two seconds: $least to $most kB"
((most - least < 20000)) || fail "memory grows: $(xargs < memory)"

# What was sent is received or lost, what is received is a scan, a pose or dropped by overload, and a
# scan is mapped, dropped for a reason or waits.
# Some of the broken fragments make a message all the same, by accident.
((missing <= lost && -missing <= $(jq .kinds.broken_fragment flood.json))) ||
  fail "$missing messages are missing, and the socket lost $lost"
(($(of .problems.lost_datagrams) == lost)) ||
  fail "the daemon counted $(of .problems.lost_datagrams) lost datagrams of $lost"
((received == $(of .scans_received) + $(of .poses_received) + overload)) ||
  fail "received messages do not add up: $(cat status.json)"
no_scans='"wrong_type_of_pose", "malformed_pose", "pose_out_of_range", "duplicate_pose", "overload"'
scan_drops=$(jq "[.dropped | to_entries[] | select(.key | IN($no_scans) | not) | .value] | add // 0" status.json)
(($(of .scans_received) == $(of .scans_mapped) + $(of .scans_queued) + scan_drops)) ||
  fail "scans do not add up: $(cat status.json)"

# says COUNT TEXT: where anything was counted, the log has the text.
says() { (($1 == 0)) || grep -qE "warning .*$2" daemon.log || fail "$1 drops were not said: $(cat daemon.log)"; }
says "$overload" "dropped [0-9]+ overload"
says "$lost" "datagrams were lost"
if splinemap diff live.splinemap quiet.splinemap; then
  echo "flood: the map is that of the quiet build"
else
  ((overload + lost > 0)) || fail "another map than that of the quiet build, and nothing was lost on the way"
  echo "flood: another map than that of the quiet build; $overload messages were dropped and $lost datagrams lost, counted and said"
fi
