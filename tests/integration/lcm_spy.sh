#!/usr/bin/env bash
# The installed splinemap-spy decodes what the daemon says and shows the map, on a hidden screen: the
# sum of layers, as decisions say, whether or not their owners are there.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

build=$(realpath "$(dirname "$(command -v splinemapd)")/../..")
if [[ ! -e $build/lcmtypes/splinemap-spy.jar ]]; then
  echo "lcm_spy: skipped, there was no JDK, lcm.jar or zstd-jni.jar to build splinemap-spy.jar with"
  exit 0
fi
cmake --install "$build" --prefix "$work/installed" > install.log || fail "$(cat install.log)"
spy=$work/installed/bin/splinemap-spy

expect 0 "$spy" --help
expect 2 "$spy" --nonsense
expect 1 env -u DISPLAY "$spy"
expect_text "DISPLAY is not set" err
mkdir no_java
ln -s /usr/bin/{bash,dirname,readlink} no_java
expect 1 env PATH="$work/no_java" "$spy"
expect_text "sudo apt-get install default-jre" err

# A type of the user's own.
cat > mine_t.lcm << 'EOT'
package mine;
struct mine_t { int32_t number; }
EOT
lcm-gen -j mine_t.lcm
javac -cp /usr/share/java/lcm.jar mine/mine_t.java
jar cf mine.jar mine/mine_t.class

# What a log of the bus has: its last word of the layers that the daemon `robot` knows, and all
# channels so far. "row CHANNEL" tells the row of lcm-spy's table, which has one a channel, by name;
# "decide NAME [FIELD=VALUE..]" writes a log with a decision about a layer.
lcm-gen -p "$top"/lcmtypes/splinemap/{control_records_t,layer_control_t,layers_t,layer_status_t}.lcm
cat > bus.py << 'EOT'
import struct, sys, time
from splinemap import control_records_t, layer_control_t, layers_t

data, at, channels, layers = open("heard.lcmlog", "rb").read(), 0, set(), []
while at + 28 <= len(data):
    name_size, size = struct.unpack_from(">II", data, at + 20)
    end = at + 28 + name_size + size
    if end > len(data):
        break  # it is being written
    name = data[at + 28:at + 28 + name_size].decode()
    channels.add(name)
    if name == "SPLINEMAP_LAYERS":
        message = layers_t.decode(data[end - size:end])
        layers = message.layers if message.name == "robot" else layers
    at = end

if sys.argv[1] == "row":
    print(sorted(channels).index(sys.argv[2]))
else:
    layer = next(layer for layer in layers if layer.name == sys.argv[2])
    control = layer_control_t()
    control.name, control.origin, control.counter = layer.name, layer.origin, time.time_ns()
    for field, value in (argument.split("=") for argument in sys.argv[3:]):
        setattr(control, field, int(value))
    records = control_records_t()
    records.num_records, records.records = 1, [control]
    channel, content = b"SPLINEMAP_CONTROL", records.encode()
    with open("decision.lcmlog", "wb") as log:
        log.write(struct.pack(">IqqII", 0xEDA1DA01, 0, 0, len(channel), len(content)))
        log.write(channel + content)
EOT
# decide NAME [FIELD=VALUE..]: as soon as the daemon knows the layer.
decide() {
  await python3 bus.py decide "$@"
  lcm-logplayer decision.lcmlog > /dev/null
}

expect 0 splinemap simulate drive.lcmlog
expect 0 splinemap build drive.lcmlog --scan LASER --pose POSE --out drive.splinemap
cat > room.world << 'EOT'
wall { x0_m: -2 y0_m: -2 x1_m: 2 y1_m: -2 }
wall { x0_m: 2 y0_m: -2 x1_m: 2 y1_m: 2 }
wall { x0_m: 2 y0_m: 2 x1_m: -2 y1_m: 2 }
wall { x0_m: -2 y0_m: 2 x1_m: -2 y1_m: -2 }
waypoint { x_m: -1 } waypoint { x_m: 1 } waypoint { x_m: 1 y_m: 1 }
EOT
expect 0 splinemap simulate room.world room.lcmlog
expect 0 splinemap build room.lcmlog --scan LASER --pose POSE --out room.splinemap --name room
cp room.splinemap kept.splinemap
Xvfb -displayfd 3 -screen 0 1000x700x24 -nolisten tcp 3> display 2> xvfb.log &
await test -s display
DISPLAY=:$(cat display)
export DISPLAY
lcm-logger --quiet --force heard.lcmlog &
CLASSPATH=$work/mine.jar "$spy" > spy.log 2>&1 &
spy_pid=$!
await xdotool search --name '^LCM Spy$'
types=$(find "$top/lcmtypes" -name '*.lcm' | wc -l)
await grep -qx "Found $((types + 1)) LCM types" spy.log
await grep -qx "Found 1 plugins" spy.log  # it listens: its table and the log begin alike
splinemapd --map map.splinemap --name robot --follow room --scan LASER --pose POSE 2> daemon.log &
splinemapd --map kept.splinemap --name room --no-sensors 2> room.log &
room=$!

# is_open TITLE WINDOW X Y: a window of the title; where there is none, a double click in another one.
is_open() {
  xdotool search --name "^$1\$" && return
  # All come to lie in the same corner, also one of a row that has just moved away.
  xdotool search --name "^$2\$" windowraise
  xdotool mousemove "$3" "$4" click --repeat 2 --delay 80 1
  sleep 0.5
  return 1
}
# is_open_of CHANNEL TITLE
is_open_of() {
  local row
  row=$(python3 bus.py row "$1") && is_open "$2" "LCM Spy" 60 $((28 + 16 * row))
}
await is_open_of SPLINEMAP_STATUS SPLINEMAP_STATUS
await is_open utime SPLINEMAP_STATUS 60 35  # a chart of a field: the message was decoded

# Whoever opens the map later has not heard the decision, nor the layer's owner.
decide room yields=1 shift_i=90 shift_j=80
kill "$room"
wait "$room" || fail "the room's daemon: $(cat room.log)"

# The map, from the middle of a drive on: what was before is pulled.
lcm-logplayer -s 20 drive.lcmlog > player.log 2>&1 &
player=$!
sleep 2
await is_open_of SPLINEMAP_UPDATES "SPLINEMAP map"
kill -0 "$player" || fail "the drive was over before the map was opened"
wait "$player"
eval "$(xdotool search --name '^SPLINEMAP map$' getwindowgeometry --shell)"
# shows MAP: the window comes to show what that file has.
shows() {
  expect 0 splinemap render "$1" map.png --px-per-knot 1
  # shellcheck disable=SC2154  # xdotool says X, Y, WIDTH, HEIGHT
  java "$top/tests/integration/MapWindow.java" "$X" "$Y" "$WIDTH" "$HEIGHT" map.png > shown.log ||
    fail "$1: $(cat shown.log)"
}
expect 0 splinemap snapshot sum.splinemap --robot robot --robot room
shows sum.splinemap
decide robot muted=1
shows room.splinemap
decide room removed_up_to=2  # as many starts as there were
decide robot muted=0
shows drive.splinemap

kill -0 "$spy_pid" || fail "lcm-spy ended: $(cat spy.log)"
echo "lcm_spy: $types types and the user's own; SPLINEMAP_STATUS is decoded; $(cat shown.log)"
