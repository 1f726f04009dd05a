#!/usr/bin/env bash
# thin_link.sh [--seconds N] [--quick]: a robot that maps 10 scans a second and reaches its fleet by a
# link of 1 Mbit/s (tbf) that loses 5 % of the packets each way (nftables). Prints how far the fleet
# is behind and what goes over the link, and ends with status 1 where the fleet falls behind, or is
# another map in the end. Exit status 77 where the system makes no namespaces.
if [[ ${1:-} != inside ]]; then
  top=$(cd "$(dirname "$(readlink -f "$0")")/../.." && pwd -P)
  dev=$top/build/dev
  command -v splinemap-uplink > /dev/null ||
    export PATH=$dev/clients/splinemap:$dev/services/splinemapd:$dev/services/uplink:$dev/services/fleet_worker:$PATH
  PATH=$PATH:/usr/sbin:/sbin
  for unshare in "unshare -nm" "unshare -rnm"; do
    # shellcheck disable=SC2086  # words of a command
    if $unshare sh -c 'mount -t tmpfs none /run && ip netns add try && ip link add try0 type veth peer name try1 &&
        tc qdisc add dev try0 root tbf rate 1mbit burst 4kb latency 100ms' 2> /dev/null; then
      # shellcheck disable=SC2086
      exec $unshare "$0" inside "$top" "$@"
    fi
  done
  echo "skipped: no network namespaces, or no tbf, here"
  exit 77
fi
arguments=("${@:3}")
mount -t tmpfs none /run
# shellcheck source=tests/integration/support.sh
source "$2/tests/integration/support.sh" "$2"

seconds=120
set -- "${arguments[@]}"
while (($#)); do
  case $1 in
    --seconds) seconds=$2; shift ;;
    --quick) seconds=20 ;;
    *) fail "unknown option $1" ;;
  esac
  shift
done

# The fleet here, the robot in a namespace of its own, the link between.
ip link set lo up
ip netns add robot
ip link add port type veth peer name eth0 netns robot
ip addr add 10.77.1.1/24 dev port
ip link set port up
on_robot() { ip netns exec robot "$@"; }
on_robot sh -c 'ip link set lo up; ip addr add 10.77.1.2/24 dev eth0; ip link set eth0 up
  ip route add 224.0.0.0/4 dev lo'
tc qdisc add dev port root tbf rate 1mbit burst 4kb latency 100ms
on_robot tc qdisc add dev eth0 root tbf rate 1mbit burst 4kb latency 100ms
lose='table inet loss { chain in { type filter hook input priority 0
  iifname NAME numgen random mod 100 < 5 drop; }; }'
nft -f - <<< "${lose/NAME/port}"
on_robot nft -f - <<< "${lose/NAME/eth0}"

nats-server -a 10.77.1.1 -js -sd "$work/jetstream" > server.log 2>&1 &
fleet=nats://10.77.1.1:4222
await grep -q "Server is ready" server.log
splinemap-fleet-worker --fleet "$fleet" > worker.log 2>&1 &
await splinemap --fleet "$fleet" layers --json
export LCM_DEFAULT_URL="udpm://239.255.76.67:7667?ttl=0&recv_buf_size=2000000"
splinemap simulate drive.lcmlog --rate 10 --pose-rate 20 2> /dev/null
ip netns exec robot splinemapd --scan LASER --pose POSE --name robot > robot.log 2>&1 &
robot=$!
ip netns exec robot splinemap-uplink --fleet "$fleet" --max-kb-per-s 80 > uplink.log 2>&1 &
ip netns exec robot splinemap watch --json > status.jsonl 2> /dev/null &
ip netns exec robot lcm-logplayer -s 1 drive.lcmlog > /dev/null 2>&1 &
player=$!

bytes() { ip -s -j link show port | jq ".[0].stats64.$1.bytes"; }
# commits_there: of the layer in the fleet.
commits_there() { splinemap --fleet "$fleet" layers --json --timeout 5 2> /dev/null | jq '.[0].commits // 0'; }
begin=$SECONDS
up=$(bytes rx) down=$(bytes tx)
worst=0
printf '%8s %12s %14s %10s\n' seconds commits_here commits_there behind_s
while ((SECONDS - begin < seconds)) && kill -0 "$player" 2> /dev/null; do
  sleep 4
  here=$(status_of robot .revision)
  there=$(commits_there)
  behind=$(((here - there + 9) / 10))
  # In the beginning there is nothing there.
  ((SECONDS - begin < 10 || behind <= worst)) || worst=$behind
  printf '%8s %12s %14s %10s\n' "$((SECONDS - begin))" "$here" "$there" "$behind"
done
up=$((($(bytes rx) - up) / (SECONDS - begin)))
down=$((($(bytes tx) - down) / (SECONDS - begin)))
kill "$player" 2> /dev/null || true
echo "10 scans a second over 1 Mbit/s with 5 % loss: the fleet is $worst s behind at most;" \
  "$((up / 1000)) kB/s up, $((down / 1000)) kB/s down"
sleep 3
kill "$robot"
wait "$robot"
hashes() { jq -c '[.[] | [.name, .tiles, .hash]]'; }
is_equal() { [[ $(splinemap --fleet "$fleet" layers --json | hashes) == "$(splinemap layers robot.splinemap --json | hashes)" ]]; }
await is_equal
((worst <= 10)) || fail "the fleet falls behind"
echo "in the end it has the robot's map"
