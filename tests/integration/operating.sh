#!/usr/bin/env bash
# What operators use: what systemd is told, the watchdog, levels of the log, metrics, the unit, bash
# completion, man pages.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

cat > room.world << 'END'
wall { x0_m: -2 y0_m: -2 x1_m: 2 y1_m: -2 } wall { x0_m: 2 y0_m: -2 x1_m: 2 y1_m: 2 }
waypoint { x_m: -1 } waypoint { x_m: 1 }
END
splinemap simulate room.world room.lcmlog 2> /dev/null

# --- systemd: ready, alive, stopping; levels in its journal
python3 "$top/tests/support/notify_socket.py" "$work/notify" > said &
await test -S notify
: > daemon.log
journal=$(stat -c %d:%i daemon.log)  # as systemd names the end of the pipe
NOTIFY_SOCKET=$work/notify WATCHDOG_USEC=4000000 JOURNAL_STREAM=$journal \
  splinemapd --map robot.splinemap --name robot --scan LASER --pose POSE --metrics-port 9187 \
  2>> daemon.log &
daemon=$!
await grep -q '^READY=1 | WATCHDOG=1 | STATUS=0 of 0 scans mapped, 0 tiles, 1 layers' said
[[ -e robot.splinemap ]] || fail "ready without a map"
lcm-logplayer -s 20 room.lcmlog > /dev/null
await grep -qE '^READY=1 \| WATCHDOG=1 \| STATUS=[1-9][0-9]* of [1-9][0-9]* scans mapped' said
grep -q '^<6>map robot.splinemap: layer robot, session 1, empty$' daemon.log ||
  fail "no level of the journal: $(cat daemon.log)"

# --- metrics, on loopback alone
metric() { awk -v name="$1" '$1 == name { print $2 }' metrics; }
status() { splinemap watch --once --json --timeout 2; }
scrape() { curl --silent --fail 127.0.0.1:9187/metrics > metrics; }
agrees() {
  status > status.json && scrape &&
    (($(metric splinemapd_scans_mapped_total) == $(jq .scans_mapped status.json))) &&
    (($(metric splinemapd_scans_mapped_total) > 5))
}
await agrees
[[ $(metric splinemapd_commits) == $(jq .revision status.json) ]] || fail "commits: $(cat metrics)"
[[ $(metric splinemapd_tiles) == $(jq .tiles status.json) ]] || fail "tiles: $(cat metrics)"
[[ $(metric 'splinemapd_problems_total{problem="bus_away"}') == 0 ]] || fail "$(cat metrics)"
ip address add 10.1.2.3/32 dev lo
curl --silent --max-time 2 10.1.2.3:9187/metrics > /dev/null && fail "metrics beyond loopback"
expect 1 splinemapd --map other.splinemap --scan LASER --pose POSE --metrics-port 9187
expect_text "metrics cannot be served at 127.0.0.1:9187" err
expect 2 splinemapd --scan LASER --pose POSE --metrics-port 65536

# --- the watchdog: a save that waits for another program is a thread that hangs
mkfifo sql
sqlite3 robot.splinemap < sql > /dev/null &
exec 8> sql
echo "BEGIN IMMEDIATE;" >&8
lcm-logplayer -s 20 room.lcmlog > /dev/null
kill -HUP "$daemon"
await grep -q '^<3>the thread that saves hangs; systemd restarts splinemapd if that lasts$' daemon.log
alive=$(grep -c WATCHDOG=1 said)
echo "ROLLBACK;" >&8
exec 8>&-
await bash -c "((\$(grep -c WATCHDOG=1 said) > $alive))"  # it got on in time

# --- it ends within a second of SIGTERM, saved; with room for a computer that is busy
begin=${EPOCHREALTIME/./}
kill "$daemon"
wait "$daemon" || fail "the daemon: $(cat daemon.log)"
took_ms=$(((${EPOCHREALTIME/./} - begin) / 1000))
((took_ms < 5000)) || fail "it took $took_ms ms to end"
await grep -q '^STOPPING=1' said
echo "it ended in $took_ms ms"
expect 0 splinemap verify robot.splinemap

# Errors at the start have levels, too; on a terminal and in other files there are none.
: > start.log
journal=$(stat -c %d:%i start.log)
JOURNAL_STREAM=$journal splinemapd --nonsense 2>> start.log && fail "no usage error"
grep -q '^<3>splinemapd: ' start.log || fail "no level: $(cat start.log)"
JOURNAL_STREAM=$journal expect 2 splinemapd --nonsense
! grep -q '^<' err || fail "levels in another file: $(cat err)"

# --- the unit
if command -v systemd-analyze > /dev/null; then
  daemon=$(command -v splinemapd)
  sed "s,^ExecStart=[^ ]*,ExecStart=$daemon," "${daemon%/*}/splinemapd@.service" \
    > splinemapd@robot-1.service
  expect 0 systemd-analyze verify --man=no ./splinemapd@robot-1.service
  [[ ! -s err ]] || fail "the unit: $(cat err)"
  expect 0 systemd-analyze security --offline=true --threshold=15 ./splinemapd@robot-1.service
  tail -n 1 out
fi

# --- bash completion
# shellcheck source=deploy/completion.bash
source "$top/deploy/completion.bash"
# completes WORD..: what is proposed for the last one.
completes() {
  COMP_WORDS=("$@")
  COMP_CWORD=$(($# - 1))
  COMPREPLY=()
  _splinemap
  echo "${COMPREPLY[*]}"
}
[[ $(completes splinemap ver) == verify ]] || fail "$(completes splinemap ver)"
[[ $(completes splinemap layer '' | wc -w) == 6 ]] || fail "$(completes splinemap layer '')"
[[ $(completes splinemap layer mute map.splinemap robot-1 --acc) == --accept-corrupt ]] ||
  fail "$(completes splinemap layer mute map.splinemap robot-1 --acc)"
[[ -z $(completes splinemap info room) ]] || fail "files are not proposed"
[[ " $(completes splinemapd --) " == *" --metrics-port "* ]] || fail "$(completes splinemapd --)"

# --- man pages
if command -v help2man > /dev/null; then
  "$top/deploy/man_pages.sh" man
  for page in splinemapd splinemap splinemap-repair splinemap-layer-mute; do
    grep -q "^$page .- [A-Za-z]" "man/$page.1" || fail "$page: $(head -n 4 "man/$page.1")"
    expect 0 man --warnings -l -Tutf8 "man/$page.1"
    [[ ! -s err ]] || fail "$page: $(cat err)"
  done
fi

echo "operating: all is well"
