#!/usr/bin/env bash
# The installed splinemap-spy decodes the daemon's messages, on a hidden screen, and opens the page
# of a viewer where one answers, here in a browser that only writes down what it is to open.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

build=$(realpath "$(dirname "$(command -v splinemapd)")/../..")
if [[ ! -e $build/lcmtypes/splinemap-spy.jar ]]; then
  echo "lcm_spy: skipped, there was no JDK or lcm.jar to build splinemap-spy.jar with"
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

# A viewer that has a port of its own, and listens on it once there is a file `begin`.
cat > viewer.py << 'EOT'
import http.server, os, time

class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200 if self.path == "/healthz" else 404)
        self.end_headers()
        self.wfile.write(b"ok\n")

server = http.server.HTTPServer(("127.0.0.1", 0), Handler, bind_and_activate=False)
server.server_bind()
with open("port.new", "w") as file:
    file.write(str(server.server_port))
os.rename("port.new", "port")
while not os.path.exists("begin"):
    time.sleep(0.1)
server.server_activate()
server.serve_forever()
EOT
python3 viewer.py 2> viewer.log &
await test -e port
page="http://127.0.0.1:$(cat port)/?token=0123"
mkdir bin
cat > bin/xdg-open << EOT
#!/bin/sh
echo "\$@" > "$work/opened"
EOT
chmod +x bin/xdg-open

expect 0 splinemap simulate drive.lcmlog
Xvfb -displayfd 3 -screen 0 1000x700x24 -nolisten tcp 3> display 2> xvfb.log &
await test -s display
DISPLAY=:$(cat display)
export DISPLAY
lcm-logger --quiet --force heard.lcmlog &
PATH=$work/bin:$PATH CLASSPATH=$work/mine.jar SPLINEMAP_VIEWER=$page "$spy" > spy.log 2>&1 &
spy_pid=$!
await xdotool search --name '^LCM Spy$'
types=$(find "$top/lcmtypes" -name '*.lcm' | wc -l)
await grep -qx "Found $((types + 1)) LCM types" spy.log
await grep -qx "Found 1 plugins" spy.log  # it listens, so its table and the log begin alike
splinemapd --map map.splinemap --name robot --scan LASER --pose POSE 2> daemon.log &
await grep -q listening daemon.log
lcm-logplayer -s 12 drive.lcmlog > player.log 2>&1 &

# point_at WINDOW X Y: all windows open in the same corner, so one may cover the other.
point_at() { xdotool search --name "^$1\$" windowraise && xdotool mousemove "$2" "$3"; }
point_at_channel() {
  local row
  row=$(python3 row.py "$1") && point_at "LCM Spy" 60 $((28 + 16 * row))
}
double_click() { xdotool click --repeat 2 --delay 80 1; }
# is_there FILE COMMAND..: whether there is the file; if not, the command may bring it.
# is_open TITLE COMMAND..: the same of a window.
is_there() { [[ -e $1 ]] || try "${@:2}"; }
is_open() { xdotool search --name "^$1\$" || try "${@:2}"; }
try() {
  "$@" && sleep 0.5
  return 1
}
double_click_on() { point_at_channel "$1" && double_click; }
click_on_a_field() { point_at SPLINEMAP_STATUS 60 35 && double_click; }

await is_open SPLINEMAP_STATUS double_click_on SPLINEMAP_STATUS
await is_open utime click_on_a_field  # a chart, so the message was decoded

await is_open splinemap-viewer double_click_on SPLINEMAP_SCANS
grep -qxF "No splinemap-viewer answers at $page; start it beside this bus: splinemap-viewer" \
  spy.log || fail "nothing is said of a viewer that is away: $(cat spy.log)"
[[ ! -e opened ]] || fail "a page was opened that nobody serves"
is_dismissed() {
  eval "$(xdotool search --name '^splinemap-viewer$' getwindowgeometry --shell)"
  [[ -n ${WINDOW:-} ]] || return 0
  # shellcheck disable=SC2153  # xdotool says X, Y, WIDTH, HEIGHT
  point_at splinemap-viewer $((X + WIDTH / 2)) $((Y + HEIGHT - 25)) && xdotool click 1 && sleep 0.5
  unset WINDOW
  return 1
}
await is_dismissed

touch begin
choose_the_map_on() {
  point_at_channel "$1" && xdotool click 3 && sleep 0.3 && xdotool mousemove_relative 20 31 click 1
}
for way in "double_click_on SPLINEMAP_SCANS" "choose_the_map_on SPLINEMAP_DIGESTS"; do
  # shellcheck disable=SC2086  # words of a command
  await is_there opened $way
  [[ $(cat opened) == "$page" ]] || fail "$way: opened $(cat opened) in place of $page"
  rm opened
done
grep -q "GET /healthz" viewer.log || fail "the viewer was not asked: $(cat viewer.log)"
has_no_empty_window() { ! xdotool search --name '^SPLINEMAP_(SCANS|DIGESTS)'; }
await has_no_empty_window

kill -0 "$spy_pid" || fail "lcm-spy ended: $(cat spy.log)"
echo "lcm_spy: $types types and the user's own; SPLINEMAP_STATUS is decoded; the page opens"
