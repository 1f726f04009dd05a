#!/usr/bin/env bash
# fleet.sh [--seconds N] [--seed N] [--quick]: faults of a fleet. Three nats-servers in network namespaces
# of their own, three robots that drive (splinemapd, each on a bus of its own, and its splinemap-uplink),
# two workers. At random: servers, the leader among them, workers and uplinks are killed and started
# again; servers are cut off from the others; uplinks are away for hours of the drive; a second uplink
# writes the same layer; all servers forget everything, or go back to an old backup; a robot goes on from
# an old copy of its map file. Where everything works again, the fleet has to have, byte for byte, what an
# offline merge of the robots' files has.
# Exit status 77 where the system makes no namespaces.
if [[ ${1:-} != inside ]]; then
  top=$(cd "$(dirname "$(readlink -f "$0")")/../.." && pwd -P)
  dev=$top/build/dev
  command -v splinemap-uplink > /dev/null ||
    export PATH=$dev/clients/splinemap:$dev/services/splinemapd:$dev/services/uplink:$dev/services/fleet_worker:$PATH
  PATH=$PATH:/usr/sbin:/sbin
  for unshare in "unshare -nm" "unshare -rnm"; do
    # shellcheck disable=SC2086  # words of a command
    if $unshare sh -c 'mount -t tmpfs none /run && ip netns add try && ip link add type bridge' 2> /dev/null; then
      # shellcheck disable=SC2086
      exec $unshare "$0" inside "$top" "$@"
    fi
  done
  echo "skipped: no network namespaces can be made here"
  exit 77
fi
arguments=("${@:3}")
mount -t tmpfs none /run
# shellcheck source=tests/integration/support.sh
source "$2/tests/integration/support.sh" "$2"

seconds=300
RANDOM=1
set -- "${arguments[@]}"
while (($#)); do
  case $1 in
    --seconds) seconds=$2; shift ;;
    --seed) RANDOM=$2; shift ;;
    --quick) seconds=25 ;;
    *) fail "unknown option $1" ;;
  esac
  shift
done

# --- a network: the robots here, a bridge, and a namespace for each server
ip link set lo up
ip route add 224.0.0.0/4 dev lo
ip link add hub type bridge
ip addr add 10.77.0.1/24 dev hub
ip link set hub up
for k in 1 2 3; do
  ip netns add "server$k"
  ip link add "port$k" type veth peer name eth0 netns "server$k"
  ip link set "port$k" master hub up
  ip netns exec "server$k" sh -c "ip link set lo up; ip link set eth0 up; ip addr add 10.77.0.1$k/24 dev eth0"
  cat > "server$k.conf" << EOF
server_name: server$k
listen: 10.77.0.1$k:4222
jetstream { store_dir: "$work/jetstream$k" }
cluster {
  name: fleet
  listen: 10.77.0.1$k:6222
  routes: [nats://10.77.0.11:6222, nats://10.77.0.12:6222, nats://10.77.0.13:6222]
}
EOF
done
fleet=nats://10.77.0.11:4222,nats://10.77.0.12:4222,nats://10.77.0.13:4222

declare -A process
# launch NAME COMMAND..: in the background, with a log.
launch() {
  local name=$1
  shift
  "$@" >> "$name.log" 2>&1 &
  process[$name]=$!
}
kill_hard() {
  kill -KILL "${process[$1]}" 2> /dev/null || true
  { wait "${process[$1]}" || true; } 2> /dev/null
  unset "process[$1]"
}
end() {
  kill "${process[$1]}" 2> /dev/null || true
  wait "${process[$1]}" 2> /dev/null || true
  unset "process[$1]"
}
start_server() { launch "server$1" ip netns exec "server$1" nats-server -c "server$1.conf"; }
start_worker() { launch "worker$1" splinemap-fleet-worker --fleet "$fleet" --replicas 3; }
bus_of() { echo "udpm://239.255.76.67:$((7700 + $1))?ttl=0&recv_buf_size=2000000"; }
start_uplink() {
  launch "uplink$1" splinemap-uplink --fleet "$fleet" --robot "robot-$1" --lcm-url "$(bus_of "$1")" \
    --interval-s 0.5 --max-kb-per-s 1000 --map "robot-$1.splinemap"
}
start_robot() {
  launch "robot$1" splinemapd --scan LASER --pose POSE --name "robot-$1" --lcm-url "$(bus_of "$1")"
}
drive() {
  (
    trap 'kill "$player"; exit' TERM
    while true; do
      lcm-logplayer -s 20 -l "$(bus_of "$1")" "drive$1.lcmlog" > /dev/null 2>&1 &
      player=$!
      wait "$player"
    done
  ) &
  process[drive$1]=$!
}
hashes() { jq -c '[.[] | [.name, .origin, .session_number, .tiles, .hash]] | sort'; }
in_fleet() { splinemap --fleet "$fleet" layers --timeout 10 --json 2> /dev/null | hashes; }
in_files() { splinemap merge robot-{1,2,3}.splinemap -o offline.splinemap --force 2> /dev/null &&
  splinemap layers offline.splinemap --json | hashes; }

for k in 1 2 3; do
  splinemap simulate "drive$k.lcmlog" --seed "$k" --rate 5 --pose-rate 20 2> /dev/null
  start_server "$k"
done
for k in 1 2; do start_worker "$k"; done
await splinemap --fleet "$fleet" layers --json
for k in 1 2 3; do
  start_robot "$k"
  start_uplink "$k"
  drive "$k"
done

# --- faults
declare -A done_faults=()
count() { done_faults[$1]=$((${done_faults[$1]:-0} + 1)); }
pause() { sleep "$((RANDOM % 3)).$((RANDOM % 10))"; }
one() { echo $((RANDOM % $1 + 1)); }
stop_servers() { for k in 1 2 3; do kill_hard "server$k"; done; }
start_servers() { for k in 1 2 3; do start_server "$k"; done; }
back_up() {
  rm -rf backup
  mkdir backup
  cp -r jetstream{1,2,3} backup/
  for k in 1 2 3; do splinemap backup "robot-$k.splinemap" "backup/robot-$k.splinemap" 2> /dev/null; done
}

end_of_faults=$((SECONDS + seconds))
kinds=(server worker uplink cut pair away twice wipe backup restore robot older)
turn=0
while ((SECONDS < end_of_faults)); do
  # Each kind once, then at random.
  kind=${kinds[$((turn < ${#kinds[@]} ? turn : RANDOM % ${#kinds[@]}))]}
  turn=$((turn + 1))
  k=$(one 3)
  case $kind in
    server) kill_hard "server$k"; pause; start_server "$k" ;;
    worker) w=$(one 2); kill_hard "worker$w"; pause; start_worker "$w" ;;
    uplink) kill_hard "uplink$k"; pause; start_uplink "$k" ;;
    cut) ip link set "port$k" down; pause; pause; ip link set "port$k" up ;;
    pair)
      ip netns exec "server$k" sh -c 'nft add table ip cut &&
        nft add chain ip cut in "{ type filter hook input priority 0; }" &&
        nft add rule ip cut in ip saddr 10.77.0.'"$((11 + k % 3))"' drop'
      pause; pause
      ip netns exec "server$k" nft delete table ip cut
      ;;
    away) end "uplink$k"; sleep 3; start_uplink "$k" ;;  # a minute of the drive
    twice)
      splinemap-uplink --fleet "$fleet" --robot "robot-$k" --lcm-url "$(bus_of "$k")" \
        --interval-s 0.3 --max-kb-per-s 1000 >> twice.log 2>&1 &
      second=$!
      sleep 3
      kill -KILL "$second"
      { wait "$second" || true; } 2> /dev/null
      ;;
    wipe) stop_servers; rm -rf jetstream{1,2,3}; start_servers ;;
    backup) stop_servers; back_up; start_servers ;;
    restore)
      [[ -d backup ]] || continue
      stop_servers
      rm -rf jetstream{1,2,3}
      cp -r backup/jetstream{1,2,3} .
      start_servers
      ;;
    older)
      [[ -d backup ]] || continue
      kill_hard "robot$k"
      rm -f "robot-$k.splinemap"*
      cp "backup/robot-$k.splinemap" .
      start_robot "$k"
      ;;
    robot) kill_hard "robot$k"; pause; start_robot "$k" ;;
  esac
  count "$kind"
  pause
done
for kind in "${kinds[@]}"; do printf '%-8s %s\n' "$kind" "${done_faults[$kind]:-0}"; done

# --- everything works again
for k in 1 2 3; do end "drive$k"; done
sleep 2
begin=$SECONDS
for k in 1 2 3; do kill -HUP "${process[robot$k]}"; done
sleep 2
for _ in {1..90}; do
  files=$(in_files || true)
  [[ -n $files && $(in_fleet) == "$files" ]] && break
  sleep 1
done
[[ -n $files && $(in_fleet) == "$files" ]] || {
  tail -n 4 ./*.log >&2
  fail "the fleet has $(in_fleet), the files have $files"
}
echo "the fleet is equal to the robots' files $((SECONDS - begin)) s after the last fault"
expect 0 splinemap --fleet "$fleet" snapshot fleet.splinemap --timeout 20
expect 0 splinemap diff offline.splinemap fleet.splinemap
# What the workers have summed.
seq 0 399 | awk '{ printf "%.3f,%.3f\n", ($1 % 20) * 1.13 - 2, int($1 / 20) * 0.71 - 2 }' > points.csv
expect 0 splinemap query offline.splinemap --points points.csv
mv out of_files
await splinemap --fleet "$fleet" query --points points.csv
for _ in {1..20}; do
  splinemap --fleet "$fleet" query --points points.csv > of_fleet 2> /dev/null || true
  cmp -s of_files of_fleet && break
  sleep 1
done
cmp of_files of_fleet || fail "the workers answer otherwise than the merged files"
echo "the workers answer as the merged files do"
