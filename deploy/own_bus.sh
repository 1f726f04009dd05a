#!/usr/bin/env bash
# own_bus.sh COMMAND..: runs a command on an LCM bus of its own, that no robot hears: in a network
# namespace that has only a loopback interface or, where the system does not allow that, on a UDP port
# of its own that does not leave this computer (ttl 0). The command finds the bus in LCM_DEFAULT_URL.
set -euo pipefail
PATH=$PATH:/usr/sbin:/sbin  # where ip is, for those who are not root

if [[ ${1:-} == --inside ]]; then
  shift
  ip link set lo up
  ip route add 224.0.0.0/4 dev lo
  exec "$@"
fi
if ((!$#)) || [[ $1 == -* ]]; then
  echo "usage: own_bus.sh COMMAND..    runs it on an LCM bus of its own, which no robot hears" >&2
  exit 2
fi

for unshare in "unshare -n" "unshare -rn"; do
  # shellcheck disable=SC2086  # words of a command
  if $unshare "$0" --inside true 2> /dev/null; then
    export LCM_DEFAULT_URL="udpm://239.255.76.67:7667?ttl=0&recv_buf_size=2000000"
    exec $unshare "$0" --inside "$@"
  fi
done
port=$((20000 + RANDOM % 20000))
echo "No network namespace can be made here; the bus is UDP port $port with ttl 0." >&2
export LCM_DEFAULT_URL="udpm://239.255.76.67:$port?ttl=0&recv_buf_size=2000000"
exec "$@"
