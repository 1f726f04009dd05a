#!/usr/bin/env bash
# The installed splinemap-spy decodes what the daemon says and shows its map, on a hidden screen.
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

expect 0 splinemap simulate drive.lcmlog
expect 0 splinemap build drive.lcmlog --scan LASER --pose POSE --out drive.splinemap
expect 0 splinemap render drive.splinemap drive.png --px-per-knot 1
Xvfb -displayfd 3 -screen 0 1000x700x24 -nolisten tcp 3> display 2> xvfb.log &
await test -s display
DISPLAY=:$(cat display)
export DISPLAY
splinemapd --map map.splinemap --scan LASER --pose POSE 2> daemon.log &
CLASSPATH=$work/mine.jar "$spy" > spy.log 2>&1 &
spy_pid=$!
await xdotool search --name '^LCM Spy$'
types=$(find "$top/lcmtypes" -name '*.lcm' | wc -l)
await grep -qx "Found $((types + 1)) LCM types" spy.log

# double_click X Y TITLE: until it has opened the window.
double_click() {
  # shellcheck disable=SC2016
  await bash -c 'xdotool search --name "^$3\$" ||
    { xdotool mousemove "$1" "$2" click --repeat 2 --delay 80 1; sleep 0.5; false; }' _ "$@"
}
# The table has one channel a row, by name; each window comes to lie in the same corner.
row() { echo $((12 + 16 * $1)); }
double_click 60 "$(row 2)" SPLINEMAP_STATUS  # SPLINEMAP_DIGESTS is the first
double_click 60 35 utime                     # a chart of a field: the message was decoded

# The map, from the middle of a drive on: what was before is pulled.
lcm-logplayer -s 20 drive.lcmlog > player.log 2>&1 &
player=$!
sleep 2
xdotool search --name '^LCM Spy$' windowraise
double_click 60 "$(row 5)" "SPLINEMAP map"  # LASER, POSE, SPLINEMAP_DIGESTS, _STATUS, _UPDATES
kill -0 "$player" || fail "the drive was over before the map was opened"
wait "$player"
eval "$(xdotool search --name '^SPLINEMAP map$' getwindowgeometry --shell)"
# shellcheck disable=SC2154  # xdotool says X, Y, WIDTH, HEIGHT
java "$top/tests/integration/MapWindow.java" "$X" "$Y" "$WIDTH" "$HEIGHT" drive.png > shown.log ||
  fail "$(cat shown.log)"

kill -0 "$spy_pid" || fail "lcm-spy ended: $(cat spy.log)"
echo "lcm_spy: $types types and the user's own; SPLINEMAP_STATUS is decoded; $(cat shown.log)"
