#!/usr/bin/env bash
# run.sh [FOLDER]: a fleet of simulated robots on three nats-servers of this computer, with the programs
# of FOLDER (build/dev): 100, 300 and 1,000 robots, and then queries to 1, 2 and 4 workers. Ends what it
# started.
set -euo pipefail
PATH=$PATH:/usr/sbin
top=$(cd "$(dirname "$(readlink -f "$0")")/../../.." && pwd -P)
programs=$(readlink -f "${1:-$top/build/dev}")
bench=$programs/tests/bench/fleet_load
cmake --build "$programs" --target fleet_load fleet_queries splinemap-fleet-worker > /dev/null
work=$(mktemp -d)
pids=()
clean_up() {
  kill "${pids[@]}" 2> /dev/null || true
  wait 2> /dev/null || true
  rm -rf "$work"
}
trap clean_up EXIT
ulimit -n "$(ulimit -Hn)"

fleet=
servers=()
for k in 1 2 3; do
  cat > "$work/server$k.conf" << EOF
server_name: server$k
listen: 127.0.0.1:$((4740 + k))
jetstream { store_dir: "$work/jetstream$k" }
cluster {
  name: load
  listen: 127.0.0.1:$((4750 + k))
  routes: [nats://127.0.0.1:4751, nats://127.0.0.1:4752, nats://127.0.0.1:4753]
}
EOF
  nats-server -c "$work/server$k.conf" -l "$work/server$k.log" &
  pids+=($!)
  servers+=(--server $!)
  fleet+=${fleet:+,}nats://127.0.0.1:$((4740 + k))
done
sleep 4
for robots in 100 300 1000; do
  "$bench/fleet_load" --fleet "$fleet" --fleet-map "load-$robots" --robots "$robots" --seconds 60 "${servers[@]}"
  echo
done

worker_flags=()
for workers in 1 2 4; do
  while ((${#worker_flags[@]} / 2 < workers)); do
    "$programs/services/fleet_worker/splinemap-fleet-worker" --fleet "$fleet" --fleet-map load-100 \
      2> "$work/worker${#pids[@]}.log" &
    pids+=($!)
    worker_flags+=(--worker $!)
  done
  sleep 12
  echo "$workers workers, 8 clients, 100 layers"
  "$bench/fleet_queries" --fleet "$fleet" --fleet-map load-100 "${worker_flags[@]}"
  echo
done
