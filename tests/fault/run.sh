#!/usr/bin/env bash
# Faults of disks, processes, clocks, buses and fleets, as many as there is time for; see README.md
# here.
set -euo pipefail

usage() {
  cat << EOF
usage: tests/fault/run.sh [--seconds N] [--seed N]

Lets faults happen to map files, programs, buses and a fleet, for about N seconds (300) of each
kind, the random ones by the seed (1). Prints what was tried and what was lost; ends with status 1
where something was lost that must not be. It takes the programs of build/dev.

  tests/fault/run.sh --seconds 1000             100,000 power cuts, 10,000 kills
  tests/fault/run.sh --seconds 60 --seed 7
EOF
}

seconds=300
seed=1
while (($#)); do
  case $1 in
    --seconds) seconds=$2; shift ;;
    --seed) seed=$2; shift ;;
    -h | --help) usage; exit 0 ;;
    *) usage >&2; exit 2 ;;
  esac
  shift
done

top=$(cd "$(dirname "$(readlink -f "$0")")/../.." && pwd -P)
dev=$top/build/dev
export PATH=$dev/clients/splinemap:$dev/clients/planner:$dev/services/splinemapd:$dev/services/uplink:$dev/services/fleet_worker:$dev/tests:$PATH
failed=()
# run NAME COMMAND..
run() {
  local status=0
  echo
  echo "== $1"
  "${@:2}" || status=$?
  ((status == 0 || status == 77)) || failed+=("$1")
}

# These write thousands of small files, and cut the power of none of them: memory does.
memory=/dev/shm
[[ -w $memory ]] || memory=${TMPDIR:-/tmp}
run "power cuts and failing disks" \
  env TMPDIR="$memory" power_cuts --cuts $((seconds * 100)) --seed "$seed"
run "kills while map files are written" \
  env TMPDIR="$memory" kills --kills $((seconds * 10)) --seed "$seed" --recovery
run "programs" "$top/tests/fault/programs.sh" --seconds $((seconds * 4 / 10)) --seed "$seed"
run "full and read-only disks" "$top/tests/integration/files.sh" "$top"
run "a hub (tcpq) and a network that die and come back" "$top/tests/integration/bus_away.sh" "$top"
run "NATS servers that are killed: what they acknowledged" \
  "$top/deploy/own_bus.sh" acknowledged --seconds "$seconds" --seed "$seed"
run "a fleet: servers, workers, uplinks, links, robots" \
  "$top/tests/fault/fleet.sh" --seconds "$seconds" --seed "$seed"
run "20 % loss, robots that leave, are killed, come back" "$top/tests/soak/fleet.sh" --quick

echo
if ((${#failed[@]})); then
  printf 'FAILED: %s\n' "${failed[@]}"
  exit 1
fi
echo "fault: nothing was lost that must not be"
