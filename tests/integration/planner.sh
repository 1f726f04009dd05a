#!/usr/bin/env bash
# The example planner has a path through a door, and goes round when the door closes.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

if ! command -v splinemap-planner > /dev/null; then
  echo "planner: skipped, splinemap-planner was not built"
  exit 0
fi
lcm-gen -p "$top"/lcmtypes/michigan/{pose_xyt_t,path2D_t}.lcm
expect 2 splinemap-planner --goal 1,1
expect 2 splinemap-planner --pose POSE --start 1,1 --goal 1,1

# The office, with walls of 10 cm beside the hall: one without any thickness that is seen from both
# sides has gaps in the map.
splinemap simulate thin.lcmlog --world-out office.world 2> /dev/null
cat >> office.world << 'EOT'
wall { x0_m: 12.1 y0_m: 7.5 x1_m: 12.1 y1_m: 13 }
wall { x0_m: 6.1 y0_m: 7.5 x1_m: 6.1 y1_m: 13 }
EOT
splinemap simulate office.world office.lcmlog 2> /dev/null

# The same with its other doors as they are at the end, from the corridor before a door of the hall,
# which closes after 8 s, when the planner has the map; the hall has another door further on.
sed '/^waypoint/,/^}/d' office.world > door.world
cat >> door.world << 'EOT'
wall { x0_m: 15.5 y0_m: 7.5 x1_m: 16.5 y1_m: 7.5 from_s: 8 }
waypoint { x_m: 14.2 y_m: 6.3 wait_s: 13 }
EOT
splinemap simulate door.world door.lcmlog 2> /dev/null

splinemapd --map live.splinemap --name robot --scan LASER --pose POSE 2> daemon.log &
daemon=$!
await splinemap watch --once --timeout 2
lcm-logplayer -s 20 office.lcmlog > /dev/null
expect 0 splinemap snapshot open.splinemap
lcm-logger --quiet --force recorded.lcmlog &
logger=$!
splinemap-planner --pose POSE --goal 16.2,9.3 --radius 0.2 --picture path.png 2> planner.log &
planner=$!
lcm-logplayer door.lcmlog > /dev/null
await grep -q "replanned in" planner.log
# A slow computer may find no way at first.
has_path() { tail -n 1 planner.log | grep -q "a path of"; }
await has_path
expect 0 splinemap snapshot closed.splinemap
kill -0 "$planner" || fail "the planner ended: $(cat planner.log)"

# The goal moves into a room that closed its only door: there is no way.
kill "$planner"
splinemap-planner --start 14.2,6.3 --goal-channel GOAL --channel NO_PATH 2> no_way.log &
planner=$!
cat > goal.py << 'EOT'
import struct, sys
from michigan.pose_xyt_t import pose_xyt_t
pose, out = pose_xyt_t(), open(sys.argv[1], "wb")
pose.x, pose.y, pose.theta = 3.0, 3.0, 1.0
for number in range(30):
    message = pose.encode()
    out.write(struct.pack(">IQQII", 0xEDA1DA01, number, 500000 * number, 4, len(message)))
    out.write(b"GOAL" + message)
EOT
python3 goal.py goal.lcmlog
lcm-logplayer goal.lcmlog > /dev/null &
await grep -q "no way" no_way.log
kill "$planner"
kill -INT "$logger"
wait "$logger" || true
kill -INT "$daemon"
wait "$daemon" || fail "the daemon: $(cat daemon.log)"

# The paths in the log; whether they are free, of points of the robot's disc along them; and times.
cat > check.py << 'EOT'
import math, struct, subprocess, sys
from michigan.path2D_t import path2D_t

RADIUS_M, DOOR_UTIME = 0.2, 9000000
data, at, paths, door_seen, no_path = open("recorded.lcmlog", "rb").read(), 0, [], None, None
while at < len(data):
    number, utime, name_size, size = struct.unpack_from(">QQII", data, at + 4)
    name = data[at + 28:at + 28 + name_size].decode()
    message = data[at + 28 + name_size:at + 28 + name_size + size]
    at += 28 + name_size + size
    if name == "CONTROLLER_PATH":
        assert message[:8].hex() == "efadf583af374079", "not the type that others know"
        path = path2D_t.decode(message)
        if path.path_length > 1:  # a slow computer may find no way at first
            paths.append((utime, path))
    if name == "NO_PATH":
        no_path = path2D_t.decode(message)
    if name == "LASER" and door_seen is None and struct.unpack_from(">q", message, 8)[0] >= DOOR_UTIME:
        door_seen = utime

def is_free(path, map_file):
    points = []
    for a, b in zip(path.path, path.path[1:]):
        steps = math.ceil(math.dist((a.x, a.y), (b.x, b.y)) / 0.02)
        for k in range(steps + 1):
            x, y = (p + (q - p) * k / max(steps, 1) for p, q in ((a.x, b.x), (a.y, b.y)))
            points += [f"{x + r * math.cos(n * math.pi / 8)},{y + r * math.sin(n * math.pi / 8)}"
                       for r in (0, RADIUS_M / 2, 0.999 * RADIUS_M) for n in range(16)]
    answers = subprocess.run(["splinemap", "query", map_file, "--points", "-"], text=True, check=True,
                             input="\n".join(points), stdout=subprocess.PIPE).stdout.split()
    assert len(answers) == len(points) > 1000
    return all(a.split(",")[6] == "1" and float(a.split(",")[2]) < 0 for a in answers)

assert len(paths) >= 2, f"{len(paths)} paths"
first, last = paths[0][1], paths[-1][1]
for path in (first, last):
    ends = [path.path[0].x, path.path[0].y, path.path[-1].x, path.path[-1].y]
    assert max(abs(a - b) for a, b in zip(ends, (14.2, 6.3, 16.2, 9.3))) < 0.05, f"{ends}"
    a, b = path.path[:2]
    assert abs(a.theta - math.atan2(b.y - a.y, b.x - a.x)) < 1e-4, "a pose does not look at the next"
assert paths[0][0] < door_seen < paths[1][0], "a path in place of another before the door closed"
assert is_free(first, "open.splinemap"), "the path through the open door is not free"
assert not is_free(first, "closed.splinemap"), "the path through the door is free when it is closed"
assert is_free(last, "closed.splinemap"), "the path round is not free"
assert max(pose.x for pose in last.path) > 19, "the path round does not go through the other door"
assert no_path is not None and no_path.path_length == 1, "a path where there is no way"
print(f"planner: round the door {(paths[-1][0] - door_seen) / 1000:.0f} ms after the first scan that "
      f"saw it closed, with {len(paths) - 2} paths past the part of it that was seen, between")
EOT
expect 0 python3 check.py
cat out
grep -o "replanned in .*" planner.log | sed 's/^/planner: /'
[[ $(head -c 4 path.png | tail -c 3) == PNG ]] || fail "no picture"
[[ -z ${SPLINEMAP_PICTURE:-} ]] || cp path.png "$SPLINEMAP_PICTURE"
