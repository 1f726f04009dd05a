#!/usr/bin/env bash
# fleet.sh [--quick] [LOG]: five robots and a base station, each on a computer of its own, end with the same
# bytes. The computers are network namespaces on a bridge, and each loses 20 % of what comes from others
# (nftables, since not every kernel has netem). A drive is shared among the robots; scans and poses stay on
# their computer (ttl 0), so that all have the same channels and only daemons talk on the bridge (ttl 1).
# One robot comes late, one leaves for good, one is killed and comes back, one comes back with an older
# copy of its file, the base station is away for a while; a client comes last. Then one robot's layer is
# removed, one muted, one placed, while robots are away that come back with their old files. Prints a
# table: s until all daemons have the same layers, and kB on the bridge. Without LOG, a bot_core log, it
# takes the recorded Intel drive or, if that is not there or with --quick, simulates one.
if [[ -z ${LCM_DEFAULT_URL:-} || ${1:-} != inside ]]; then
  top=$(cd "$(dirname "$(readlink -f "$0")")/../.." && pwd -P)
  dev=$top/build/dev
  command -v roll_call > /dev/null ||
    export PATH=$dev/clients/splinemap:$dev/services/splinemapd:$dev/tests:$PATH
  exec "$top/deploy/own_bus.sh" "$0" inside "$top" "$PWD" "$@"
fi
folder=$3
arguments=("${@:4}")
# shellcheck source=tests/integration/support.sh
source "$2/tests/integration/support.sh" "$2"
: "${work:?}" "${top:?}" "${shared_data:?}"
PATH=$PATH:/usr/sbin:/sbin

quick=
log=
set -- "${arguments[@]}"
while (($#)); do
  case $1 in
    --quick) quick=yes ;;
    -*) fail "unknown option $1" ;;
    *) log=$(cd "$folder" && realpath "$1") ;;
  esac
  shift
done

if ! { unshare -n true && ip link add bridge type bridge mcast_snooping 0 && unshare -n nft list ruleset; } 2> /dev/null; then
  echo "skipped: no network namespaces, no bridge or no nftables here"
  exit 77
fi
ip link set bridge up
loss_percent=20
port=7667
bus="udpm://239.255.76.67:$port?recv_buf_size=2000000"
export LCM_DEFAULT_URL="$bus&ttl=1"

declare -A network=() daemon=() player=()

make_computer() {  # NAME LOSS_PERCENT
  local n=$((${#network[@]} + 1)) pid
  unshare -n sleep infinity &
  pid=$!
  network[$1]=$pid
  await bash -c "[[ ! /proc/$pid/ns/net -ef /proc/self/ns/net ]]"
  ip link add "port$n" type veth peer name eth0 netns "$pid"
  ip link set "port$n" master bridge up
  on "$1" sh -c "ip link set lo up && ip addr add 10.0.0.$n/24 dev eth0 && ip link set eth0 up &&
    ip route add 224.0.0.0/4 dev eth0"
  on "$1" nft -f - << EOT
table ip lossy {
  chain in {
    type filter hook input priority 0
    udp dport $port ip saddr != 10.0.0.$n numgen random mod 100 < $2 drop
  }
}
EOT
}
on() { nsenter -t "${network[$1]}" -n "${@:2}"; }  # NAME COMMAND..

start() {  # NAME..
  local name inputs
  for name; do
    inputs=(--scan LASER --pose POSE --follow 'robot-*')
    [[ $name != base ]] || inputs=(--no-sensors)
    nsenter -t "${network[$name]}" -n splinemapd --config daemon.textproto --map "$name.splinemap" \
      --name "$name" "${inputs[@]}" 2>> "$name.log" &
    daemon[$name]=$!
  done
}
stop() {  # NAME..
  local name
  for name; do kill "${daemon[$name]}"; done
  for name; do
    wait "${daemon[$name]}" || fail "$name ended with status $?: $(cat "$name.log")"
    unset "daemon[$name]"
  done
}
kill_daemon() {  # NAME
  kill -KILL "${daemon[$1]}"
  wait "${daemon[$1]}" 2> /dev/null || true
  unset "daemon[$1]"
}
play() {  # NAME..
  local name
  for name; do
    await grep -q "listening on POSE" "$name.log"
    nsenter -t "${network[$name]}" -n lcm-logplayer --lcm-url="$bus&ttl=0" -s "$speed" \
      "part_${name#robot-}.lcmlog" > /dev/null &
    player[$name]=$!
  done
}
calc() { jq -n "$1"; }
wait_units() { sleep "$(calc "$1 * $replay_s / 24")"; }  # of 24 that the replay lasts
bridge_bytes() { ip -s -j link | jq '[.[] | select(.ifname | startswith("port")) | .stats64.rx.bytes] | add'; }

# row WHAT: how long it takes until all daemons that run have the same layers, and what was sent since
# the last row.
bytes_before=0
row() {
  local seconds bytes
  seconds=$(on observer roll_call "${!daemon[@]}" --timeout 40) || fail "$1: $(tail -n 3 ./*.log)"
  bytes=$(bridge_bytes)
  printf '%-52s %8s %10.0f\n' "$1" "$seconds" "$(calc "($bytes - $bytes_before) / 1000")"
  bytes_before=$bytes
}

# hashes MAP: what has to be the same in all copies.
hashes() {
  splinemap layers "$1" --json | jq -c 'sort_by(.name, .origin) | .[] | select(.tiles != 0) | [.name, .origin,
    .session_number, .session_nonce, .commits, .hash, .muted, .low_weight, .placement, .removed_up_to]'
}
same() {  # A B
  expect 0 splinemap diff "$1" "$2"
  cmp <(hashes "$1") <(hashes "$2") || fail "$1 and $2 differ: $(hashes "$1") $(hashes "$2")"
}
layer_hash() { splinemap layers "$1" --json | jq -r ".[] | select(.name == \"$2\") | .hash"; }
snapshot() { expect 0 on client splinemap snapshot "$@" --timeout 40; }
change_layer() { expect 0 on client splinemap layer "$1" --live "${@:2}"; }  # COMMAND LAYER [X_M Y_M YAW_DEG]

robots=(robot-{1..5})
for name in "${robots[@]}" base client; do make_computer "$name" $loss_percent; done
make_computer observer 0

replay_s=60
[[ -z $quick ]] || replay_s=8
intel=$shared_data/carmen/intel-corrected.log.gz
if [[ -z $log ]]; then
  log=$work/drive.lcmlog
  if [[ -z $quick && -f $intel ]]; then
    splinemap import-carmen "$intel" "$log" 2> /dev/null
  else
    splinemap simulate "$log" 2> /dev/null
  fi
fi
drive_s=$(splinemap doctor "$log" --json --scan LASER --pose POSE |
  jq '[.channels[] | select(.name == "LASER") | (.messages - 1) / .rate_hz] | add')
speed=$(calc "$drive_s / $replay_s")
"$top/tests/support/split_drive.py" "$log" LASER 5 part_
# Without scans a layer is placed where it is read.
printf 'service { save_interval_s: 1 max_archive_mb: 0 }\n' > daemon.textproto

printf '%-52s %8s %10s\n' "what happened" "equal, s" "bridge, kB"
start base robot-{1,2,4,5}
row "five daemons begin"
play robot-{1,2,4,5}
wait_units 4
start robot-3
play robot-3
wait_units 2
kill_daemon robot-4
wait_units 1
stop robot-5
cp robot-5.splinemap older.splinemap
start robot-5  # twice, so that the others know a later session than the copy's next one
wait_units 1
stop robot-5
start robot-5
wait_units 1
start robot-4
wait_units 2
stop base
wait_units 3
start base
wait_units 2
kill_daemon robot-5
rm -f robot-5.splinemap*
cp older.splinemap robot-5.splinemap
start robot-5
wait "${player[robot-2]}"
stop robot-2
wait "${player[@]}"
row "replayed; late, left, killed, older file, base away"
grep -q "is an older copy. It continues as session" robot-5.log || fail "robot-5: $(cat robot-5.log)"

# --- a client that comes last, and the robots' files
begin_s=$(date +%s.%N)
on client splinemap snapshot alone_4.splinemap --robot robot-4 --timeout 40 2> alone_4.log &
alone=$!
snapshot client.splinemap
printf '%-52s %8.1f\n' "a client has it" "$(calc "$(date +%s.%N) - $begin_s")"
wait "$alone" || fail "robot-4 alone: $(cat alone_4.log)"
sleep 1.5  # until all have saved
expect 0 splinemap merge robot-?.splinemap -o merged.splinemap
same merged.splinemap client.splinemap
same merged.splinemap base.splinemap
[[ $(splinemap layers merged.splinemap --json | jq length) == 5 ]] || fail "layers: $(hashes merged.splinemap)"
for k in 1 2 3; do  # which saw all of their parts
  expect 0 splinemap build "part_$k.lcmlog" "alone_$k.splinemap" --name "robot-$k" --scan LASER --pose POSE \
    --config daemon.textproto
  [[ $(layer_hash merged.splinemap "robot-$k") == "$(layer_hash "alone_$k.splinemap" "robot-$k")" ]] ||
    fail "the layer of robot-$k is not what it has seen: $(hashes merged.splinemap)"
done

# --- one of five is removed while its robot is away
expect 0 splinemap merge alone_{1..4}.splinemap -o four.splinemap
stop robot-5
change_layer remove robot-5
row "robot-5 is removed, away"
snapshot without.splinemap
expect 0 splinemap diff four.splinemap without.splinemap

# --- one is muted, one that left is placed; the removed one and one that missed it come back
stop robot-4
change_layer mute robot-1
change_layer place robot-2 0.35 -2 12.5
start robot-{2,4,5}
row "muted, placed; robots 2, 4, 5 come back"
grep -q "removed the layer robot-5; it goes on empty" robot-5.log ||
  [[ $(splinemap layers robot-5.splinemap --json | jq '[.[] | select(.name == "robot-5") | .tiles] | add') == 0 ]] ||
  fail "robot-5 is not empty"
expect 0 splinemap layer mute four.splinemap robot-1 --out muted.splinemap
expect 0 splinemap layer place muted.splinemap robot-2 0.35 -2 12.5 --out changed.splinemap
snapshot live.splinemap
expect 0 splinemap diff changed.splinemap live.splinemap
for map in changed live; do splinemap export $map.splinemap $map --format csv 2> /dev/null; done
cmp changed.csv live.csv || fail "the map with changed settings is another"

# --- the removed robot maps anew
if [[ -z $quick ]]; then
  play robot-5
  wait "${player[robot-5]}"
  row "robot-5 maps anew"
  expect 0 splinemap build part_5.lcmlog alone_5.splinemap --name robot-5 --scan LASER --pose POSE \
    --config daemon.textproto
fi

snapshot last.splinemap
stop "${!daemon[@]}"
for name in "${robots[@]}" base; do same last.splinemap "$name.splinemap"; done
[[ -n $quick || $(layer_hash last.splinemap robot-5) == "$(layer_hash alone_5.splinemap robot-5)" ]] ||
  fail "robot-5 is not what it has seen"
echo "fleet: five robots, the base station and a client ended with the same bytes at $loss_percent % loss"
