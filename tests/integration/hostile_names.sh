#!/usr/bin/env bash
# Escape codes, line ends and bytes that are no UTF-8, in whatever text a bus or a file has: no command
# and no log sends them to a terminal.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

# plain FILE..: printable UTF-8 and ends of lines, and no name goes on in a line of its own.
plain() {
  local file
  for file; do
    iconv -f UTF-8 -t UTF-8 "$file" > /dev/null 2>&1 || fail "no UTF-8: $(cat -v "$file")"
    if LC_ALL=C grep -qP '[\x00-\x08\x0b-\x1f\x7f]|\xc2[\x80-\x9f]' "$file"; then
      fail "control characters: $(cat -v "$file")"
    fi
    if grep -q '^\\x0d' "$file"; then fail "an end of line in a name: $(cat -v "$file")"; fi
  done
}
# run STATUS NAMES COMMAND..: it ends so, says these names, and its output is plain.
run() {
  local wanted=$1 name names
  read -ra names <<< "$2"
  shift 2
  expect "$wanted" "$@"
  plain out err
  for name in "${names[@]}"; do
    grep -qF "$name" out err || fail "no $name: $* : $(cat out err)"
  done
}
json() {
  run "$@" --json
  jq . out > out.json || fail "no JSON: $(cat out)"
}

# Maps.
layers="Xfirst Xsecond Xmuted"
hostile_names map a.splinemap 40
hostile_names map b.splinemap 50
run 0 "$layers" splinemap info a.splinemap
json 0 "$layers" splinemap info a.splinemap
run 0 "$layers" splinemap layers a.splinemap
json 0 "$layers" splinemap layers a.splinemap
run 1 "$layers" splinemap diff a.splinemap b.splinemap
run 0 "$layers" splinemap merge a.splinemap b.splinemap -o merged.splinemap
run 2 "$layers" splinemap layer remove a.splinemap X -o removed.splinemap
run 0 "Xmuted" splinemap flatten a.splinemap flat.splinemap --name flat
cp a.splinemap damaged.splinemap
sqlite3 damaged.splinemap "UPDATE tile SET checksum = checksum + 1"
run 1 "" splinemap info damaged.splinemap
run 1 "" splinemap merge damaged.splinemap b.splinemap -o none.splinemap

# Logs.
hostile_names log log.lcmlog
run 0 "Xpose1 Xscan1" splinemap doctor log.lcmlog
json 0 "Xpose1 Xscan1" splinemap doctor log.lcmlog
run 2 "Xscan1 Xscan2" splinemap build log.lcmlog none.splinemap
printf '1,2\nXline\x1b[2J\r\xff\n' > points.csv
run 2 "Xline" splinemap query a.splinemap --points points.csv

# A bus.
hostile_names bus &
splinemapd --map live.splinemap --name robot --scan LASER --pose POSE --follow '*' 2> daemon.log &
daemon=$!
await grep -q Xcoarse daemon.log
run 0 "Xname Xreason Xlast" splinemap watch --once
json 0 "Xname Xreason Xproblem Xlast" splinemap watch --once
run 0 "Xdaemon Xrefused Xlayer Xstate" splinemap layers --live
json 0 "Xdaemon Xrefused Xlayer Xstate" splinemap layers --live
run 1 "Xcoarse Xmissing" splinemap snapshot none.splinemap --timeout 3
run 1 "Xchannel" splinemap doctor --live --seconds 1
run 2 "Xtext" splinemap query --live --robot "$(printf 'Xrobot\x1b[2J\n\r\x9b\x07\xff\xc2\x9bXrobot<img src=//hostile onerror=alert(1)>')" 0 0
run 1 "Xrobot" splinemap query --live --robot nobody 0 0
run 2 "Xlayer" splinemap layer mute --live nothing
# In a terminal, what draws the screen is splinemap's alone.
script -qfc "timeout 4 splinemap watch" screen > /dev/null < /dev/null || true
for name in Xname Xlast Xmissing Xcoarse; do grep -q "$name" screen || fail "no $name on the screen"; done
if LC_ALL=C grep -qP 'X[a-z]*\x1b(?!\[K)|\x07|\xc2\x9b|\xff' screen; then fail "the screen: $(cat -v screen)"; fi
sleep 1
kill "$daemon"
wait "$daemon" || fail "the daemon: $(cat -v daemon.log)"
sed -i 's/\x1b\[[0-9;]*m//g' daemon.log  # colours
plain daemon.log
grep -q Xtwice daemon.log || fail "no Xtwice: $(cat daemon.log)"
