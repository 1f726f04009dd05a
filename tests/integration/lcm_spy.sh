#!/usr/bin/env bash
# The installed splinemap-spy decodes the daemon's messages and shows the map, on a hidden screen.
# The map is the sum of layers as the settings say, with layers whose owners are gone.
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

# The follower reads and answers messages as the C++ code does.
jars=$build/lcmtypes/splinemap-types.jar:$build/lcmtypes/splinemap-spy.jar
jars+=:/usr/share/java/lcm.jar:/usr/share/java/zstd-jni.jar
javac -cp "$jars" -d vectors "$top/tests/integration/FollowerVectors.java"
expect 0 java -cp "vectors:$jars" splinemap.spy.FollowerVectors

# A type of the user's own.
cat > mine_t.lcm << 'EOT'
package mine;
struct mine_t { int32_t number; }
EOT
lcm-gen -j mine_t.lcm
javac -cp /usr/share/java/lcm.jar mine/mine_t.java
jar cf mine.jar mine/mine_t.class

# The row of a channel in lcm-spy's table, which is sorted by name; a log has all channels.
cat > row.py << 'EOT'
import struct, sys

data, at, channels = open("heard.lcmlog", "rb").read(), 0, set()
while at + 28 <= len(data):
    name_size, size = struct.unpack_from(">II", data, at + 20)
    if at + 28 + name_size + size > len(data):
        break  # the logger is writing it
    channels.add(data[at + 28:at + 28 + name_size])
    at += 28 + name_size + size
print(sorted(channels).index(sys.argv[1].encode()))
EOT

expect 0 splinemap simulate drive.lcmlog
expect 0 splinemap build drive.lcmlog --scan LASER --pose POSE drive.splinemap
cat > room.world << 'EOT'
wall { x0_m: -2 y0_m: -2 x1_m: 2 y1_m: -2 }
wall { x0_m: 2 y0_m: -2 x1_m: 2 y1_m: 2 }
wall { x0_m: 2 y0_m: 2 x1_m: -2 y1_m: 2 }
wall { x0_m: -2 y0_m: 2 x1_m: -2 y1_m: -2 }
waypoint { x_m: -1 } waypoint { x_m: 1 } waypoint { x_m: 1 y_m: 1 }
EOT
expect 0 splinemap simulate room.world room.lcmlog
expect 0 splinemap build room.lcmlog --scan LASER --pose POSE room.splinemap --name room
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
await grep -qx "Found 1 plugins" spy.log  # it listens, so its table and the log begin alike
splinemapd --map map.splinemap --name robot --follow room --scan LASER --pose POSE 2> daemon.log &
splinemapd --map kept.splinemap --name room --no-sensors 2> room.log &
room=$!

# is_open TITLE WINDOW X Y: whether a window has the title; if not, a double click in WINDOW.
is_open() {
  xdotool search --name "^$1\$" && return
  # All windows open in the same corner, so one may cover the other.
  xdotool search --name "^$2\$" windowraise
  xdotool mousemove "$3" "$4" click --repeat 2 --delay 80 1
  sleep 0.5
  return 1
}
# is_open_of CHANNEL TITLE
is_open_of() {
  local row
  row=$(python3 row.py "$1") && is_open "$2" "LCM Spy" 60 $((28 + 16 * row))
}
await is_open_of SPLINEMAP_STATUS SPLINEMAP_STATUS
await is_open utime SPLINEMAP_STATUS 60 35  # a chart of a field, so the message was decoded

# The map is opened later, and has heard neither the settings nor the layer's owner.
knows_room() {
  splinemap layers --live --json |
    jq -e '.[] | select(.daemon == "robot").layers[] | select(.name == "room" and .state == "live")'
}
await knows_room
expect 0 splinemap layer low-weight --live robot
expect 0 splinemap layer shift --live room 90 80
kill "$room"
wait "$room" || fail "the room's daemon: $(cat room.log)"

# The map is opened in the middle of a drive, and pulls what was mapped before.
lcm-logplayer -s 12 drive.lcmlog > player.log 2>&1 &
player=$!
sleep 2
await is_open_of SPLINEMAP_UPDATES "SPLINEMAP map"
kill -0 "$player" || fail "the drive was over before the map was opened"
wait "$player"
eval "$(xdotool search --name '^SPLINEMAP map$' getwindowgeometry --shell)"
# shows MAP: the window shows what the file has, after a while.
shows() {
  expect 0 splinemap render "$1" map.png --px-per-knot 1 --force
  xdotool search --name '^SPLINEMAP map$' windowraise  # a chart may cover it
  # shellcheck disable=SC2154  # xdotool says X, Y, WIDTH, HEIGHT
  java "$top/tests/integration/MapWindow.java" "$X" "$Y" "$WIDTH" "$HEIGHT" map.png > shown.log ||
    fail "$1: $(cat shown.log)"
}
# A busy machine maps for a while after the drive.
is_settled() {
  local before=${revision:-}
  revision=$(splinemap watch --once --json --timeout 3 | jq .revision)
  [[ $revision == "$before" ]]
}
await is_settled
# The snapshot is from the log: a follower on the bus would ask for the settings, and lcm-spy would
# hear them, too.
await splinemap snapshot --log heard.lcmlog sum.splinemap --robot robot --robot room --force
shows sum.splinemap
expect 0 splinemap layer mute --live robot
shows room.splinemap
expect 0 splinemap layer remove --live room
expect 0 splinemap layer unmute --live robot
shows drive.splinemap

kill -0 "$spy_pid" || fail "lcm-spy ended: $(cat spy.log)"
echo "lcm_spy: $types types and the user's own; SPLINEMAP_STATUS is decoded; $(cat shown.log)"
