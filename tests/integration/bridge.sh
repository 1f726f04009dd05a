#!/usr/bin/env bash
# What splinemap bridge publishes is what splinemap export writes of the same map.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

expect 2 splinemap bridge
expect 2 splinemap bridge occupancy-grid --region 1,2,3
lcm-gen -p "$top/lcmtypes/michigan/occupancy_grid_t.lcm"

# The last message of each channel of a log, and the export of the same places: CHANNEL=CSV=SAMPLES,
# where SAMPLES x SAMPLES points of the export are one cell.
cat > compare.py << 'EOT'
import csv, struct, sys
from michigan.occupancy_grid_t import occupancy_grid_t

count = {}

def messages(log):
    data, at, last = open(log, "rb").read(), 0, {}
    while at + 28 <= len(data):
        name_size, size = struct.unpack_from(">II", data, at + 20)
        if at + 28 + name_size + size > len(data):
            break  # it is being written
        name = data[at + 28:at + 28 + name_size].decode()
        last[name] = data[at + 28 + name_size:at + 28 + name_size + size]
        count[name] = count.get(name, 0) + 1
        at += 28 + name_size + size
    return last

last = messages(sys.argv[1]) if len(sys.argv) > 1 else {}
for argument in sys.argv[2:]:
    channel, table, samples = argument.split("=")
    assert last[channel][:8].hex() == "d5447e494a66cc92", "not the type that others know"
    grid = occupancy_grid_t.decode(last[channel])
    assert grid.num_cells == grid.width * grid.height == len(grid.cells)
    greatest = {}
    for line in csv.DictReader(open(table)):
        # As those who read the type find the cell of a point.
        x = int((float(line["x_m"]) - grid.origin_x) / grid.meters_per_cell)
        y = int((float(line["y_m"]) - grid.origin_y) / grid.meters_per_cell)
        assert 0 <= x < grid.width and 0 <= y < grid.height, "a point off the grid"
        log_odds = greatest.setdefault((x, y), [])
        if line["known"] == "1":
            log_odds.append(float(line["log_odds"]))
    values, small = set(), 0
    for y in range(grid.height):
        for x in range(grid.width):
            cell, log_odds = grid.cells[y * grid.width + x], greatest.get((x, y), [])
            assert (cell == 0) == (not log_odds), f"{x}, {y}: {cell} of {log_odds}"
            if not log_odds:
                continue
            exact = 12.7 * max(log_odds)
            small += abs(exact) < 0.5
            assert abs(cell - exact) < (1.1 if abs(exact) < 0.6 else 0.6), f"{x}, {y}: {cell} is {exact}"
            assert (cell > 0) == (exact > 0) or abs(exact) < 0.05, f"{x}, {y}: {cell} is {exact}"
            values.add(cell)
    assert len(values) > 50 and min(values) < -90 and max(values) > 30, f"{sorted(values)}"
    assert grid.width * grid.height * int(samples) ** 2 >= sum(1 for _ in open(table)) - 1
    print(f"bridge: {channel}: {grid.width} x {grid.height} cells of {grid.meters_per_cell:.2f} m, "
          f"{count[channel]} messages, {small} known cells that would round to 0")
    if samples == "1":
        assert small > 0, "nothing that would round to 0"
EOT

splinemap simulate office.lcmlog 2> /dev/null
splinemapd --map live.splinemap --name robot --scan LASER --pose POSE 2> daemon.log &
daemon=$!
await splinemap watch --once --timeout 2
splinemap bridge occupancy-grid --rate-hz 5 2> whole.log &
whole=$!
splinemap bridge occupancy-grid --channel PART --region=1,2,11,9 --rate-hz 5 2> part.log &
splinemap bridge occupancy-grid --channel COARSE --resolution 0.15 2> coarse.log &
splinemap bridge occupancy-grid --channel NOBODY --robot nobody 2> /dev/null &
lcm-logger --quiet --force recorded.lcmlog &
logger=$!
lcm-logplayer -s 20 office.lcmlog > /dev/null
expect 0 splinemap snapshot whole.splinemap
expect 0 splinemap export whole.splinemap whole --format csv
expect 0 splinemap export whole.splinemap part --format csv --region 1,2,11,9
# Large messages may be lost, and come again.
compare=(python3 compare.py recorded.lcmlog SLAM_MAP=whole.csv=1 PART=part.csv=1 COARSE=whole.csv=3)
await "${compare[@]}"

# A region of more than 4 million cells ends it with a hint.
expect 1 timeout 20 splinemap bridge occupancy-grid --channel FINE --region=0,0,20,13 \
  --resolution 0.004
expect_text "make --region smaller, or --resolution greater than 0.004 m" err
kill -0 "$whole" || fail "the bridge ended: $(cat whole.log)"
grep -q "loses some messages of" whole.log || fail "silent about the size: $(cat whole.log)"
[[ $(grep -c "loses some" whole.log) == 1 ]] || fail "said again: $(cat whole.log)"
! grep -q "loses some" part.log coarse.log || fail "said of small messages"
kill -INT "$logger"
wait "$logger" || true
expect 0 "${compare[@]}"
cat out
! grep -q NOBODY recorded.lcmlog || fail "a map of nobody"

# A map of so many does not, here one with a scan that is far away: the rest is published.
cat > far.world << 'EOF'
wall { x0_m: 20002 y0_m: 19990 x1_m: 20002 y1_m: 20010 } waypoint { x_m: 20000 y_m: 20000 }
EOF
expect 0 splinemap simulate far.world far.lcmlog
expect 0 splinemap build far.lcmlog far.splinemap --name far
splinemapd --map far.splinemap --no-sensors --name base 2> far.log &
far=$!
await grep -q "SLAM_MAP: the map has more cells than the 4e+06 that a message takes" whole.log
lcm-logplayer -s 20 office.lcmlog > /dev/null  # the robot maps on
lcm-logger --quiet --force after.lcmlog &
after=$!
covers_office() {
  python3 - << 'EOT'
from compare import messages
from michigan.occupancy_grid_t import occupancy_grid_t

grid = occupancy_grid_t.decode(messages("after.lcmlog")["SLAM_MAP"])
assert -5 < grid.origin_x < 0 and 24 < grid.origin_x + grid.width * grid.meters_per_cell < 30
assert sum(cell != 0 for cell in grid.cells) > 100_000
EOT
}
await covers_office
kill -INT "$after" "$far"
wait "$after" "$far" || true
[[ $(grep -c "more cells than" whole.log) == 1 ]] || fail "said again: $(cat whole.log)"
kill -INT "$daemon"
wait "$daemon" || fail "the daemon: $(cat daemon.log)"
