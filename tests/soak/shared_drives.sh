#!/usr/bin/env bash
# shared_drives.sh [NAME[:ROBOTS]..]: recorded drives shared among robots, each with a daemon of its own that
# follows all others, and a base station, on one bus. At the end the files of all daemons and the copy of a
# client have the bytes of the parts built and merged offline. Without arguments five drives among 2, 5 and
# 20 robots, half a minute each; drives are those of the shared data folder.
if [[ -z ${LCM_DEFAULT_URL:-} || ${1:-} != inside ]]; then
  top=$(cd "$(dirname "$(readlink -f "$0")")/../.." && pwd -P)
  dev=$top/build/dev
  export PATH=$dev/clients/splinemap:$dev/services/splinemapd:$dev/tests:$PATH
  exec "$top/deploy/own_bus.sh" "$0" inside "$top" "$@"
fi
# shellcheck source=tests/integration/support.sh
source "$2/tests/integration/support.sh" "$2"
: "${work:?}" "${top:?}" "${shared_data:?}"
shares=("${@:3}")
((${#shares[@]})) || shares=({intel,csail,aces,freiburg-079,belgioioso}:{2,5,20})

# One log of all parts, the scans of each on a channel of its own, in fifteen seconds.
cat > together.py << 'EOT'
import struct, sys
events, last = [], {}
for k, path in enumerate(sys.argv[2:], 1):
    data, at = open(path, "rb").read(), 0
    while at < len(data):
        utime, name_size, size = struct.unpack_from(">QII", data, at + 12)
        name = data[at + 28:at + 28 + name_size]
        end = at + 28 + name_size + size
        if name == b"LASER" or k == 1:
            events.append((utime, b"LASER_%d" % k if name == b"LASER" else name, data[end - size:end]))
        at = end
events.sort(key=lambda event: event[0])
begin, span = events[0][0], events[-1][0] - events[0][0]
with open(sys.argv[1], "wb") as log:
    for number, (utime, name, message) in enumerate(events):
        squeezed = (utime - begin) * 15000000 // span
        log.write(struct.pack(">IQQII", 0xEDA1DA01, number, squeezed, len(name), len(message)))
        log.write(name + message)
EOT

# Layers with tiles, alike for all daemons that there should be?
are_alike() {
  splinemap layers --live --json --timeout 2.2 | jq -e --argjson daemons $((robots + 1)) --argjson robots "$robots" '
    [.[].layers | map(select(.tiles > 0) | [.name, .session_number, .hash]) | sort] |
    length == $daemons and (unique | length == 1 and (.[0] | length) == $robots)'
}

for share in "${shares[@]}"; do
  drive=${share%:*}
  robots=${share#*:}
  rm -f ./*.splinemap ./*.lcmlog
  expect 0 splinemap import-carmen "$shared_data/carmen/$drive-corrected.log.gz" drive.lcmlog
  "$top/tests/support/split_drive.py" drive.lcmlog LASER "$robots" part_
  parts=()
  built=()
  daemons=()
  for ((k = 1; k <= robots; ++k)); do
    parts+=("part_$k.lcmlog")
    built+=("built_$k.splinemap")
    expect 0 splinemap build "part_$k.lcmlog" "built_$k.splinemap" --name "robot-$k"
    splinemapd --scan "LASER_$k" --pose POSE --name "robot-$k" --follow 'robot-*' \
      --map "robot_$k.splinemap" 2> "robot_$k.log" &
    daemons+=($!)
  done
  splinemapd --no-sensors --name base --map base.splinemap 2> base.log &
  daemons+=($!)
  python3 together.py together.lcmlog "${parts[@]}"
  for ((k = 1; k <= robots; ++k)); do await grep -q listening "robot_$k.log"; done
  lcm-logplayer together.lcmlog > /dev/null
  # The last scans of a daemon wait for what might still come before them.
  sleep 1
  for _ in {1..20}; do are_alike > alike.json && break; done
  are_alike > alike.json || fail "$share: $(cat alike.json)"
  expect 0 splinemap snapshot client.splinemap --timeout 30
  kill "${daemons[@]}"
  wait "${daemons[@]}" || fail "$share: a daemon failed"
  expect 0 splinemap merge "${built[@]}" -o offline.splinemap
  for file in base client robot_{1..2}; do
    expect 0 splinemap flatten "$file.splinemap" flat.splinemap --name flat --force
    expect 0 splinemap flatten offline.splinemap offline_flat.splinemap --name flat --force
    expect 0 splinemap diff flat.splinemap offline_flat.splinemap
  done
  expect 0 splinemap diff base.splinemap client.splinemap
  for ((k = 1; k <= robots; ++k)); do expect 0 splinemap diff base.splinemap "robot_$k.splinemap"; done
  echo "$drive shared among $robots: $(cat out)"
done
