#!/usr/bin/env bash
# No signal and no dead terminal ends the daemon unsaved, on a bus of its own.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

# Saves by itself once an hour.
cat > mapping.textproto << 'END'
map: "live.splinemap" name: "robot" pose: "POSE" scan { channel: "LASER" }
service { save_interval_s: 3600 }
END
cat > room.world << 'END'
wall { x0_m: -2 y0_m: -2 x1_m: 2 y1_m: -2 }
wall { x0_m: 2 y0_m: -2 x1_m: 2 y1_m: 2 }
waypoint { x_m: -1 } waypoint { x_m: 1 }
END
splinemap simulate room.world room.lcmlog 2> /dev/null

commits_in_file() { jq '.layers[0].commits' <(splinemap info live.splinemap --json); }
mapped() { splinemap watch --once --json --timeout 2 | jq .revision; }
# drive: what the robot's drive adds to the map is there.
drive() {
  local before
  before=$(mapped)
  lcm-logplayer -s 20 room.lcmlog > /dev/null
  await bash -c "((\$(splinemap watch --once --json --timeout 2 | jq .revision) > $before))"
}
start() {
  rm -f live.splinemap*
  splinemapd --config mapping.textproto 2> daemon.log &
  daemon=$!
  await splinemap watch --once --timeout 2
  drive
}
# ends_saved: the daemon is ending, and nothing that it has mapped is lost.
ends_saved() {
  wait "$daemon" || fail "$1: status $?; $(cat daemon.log)"
  [[ $(commits_in_file) == $(grep -o 'mapped [0-9]*' daemon.log | cut -d' ' -f2) ]] ||
    fail "$1: $(commits_in_file) scans are saved; $(cat daemon.log)"
  (($(commits_in_file) > 5)) || fail "$1: nothing was mapped"
}

# Each signal that can be sent and caught.
ending=(INT TERM QUIT PWR XCPU ABRT BUS FPE ILL SEGV SYS TRAP)
harmless=(HUP USR1 USR2 PIPE ALRM VTALRM PROF STKFLT IO XFSZ CHLD URG WINCH CONT TTIN TTOU)
for number in $(seq "$(kill -l RTMIN)" "$(kill -l RTMAX)"); do harmless+=("$number"); done
all=$(kill -l $(seq 1 31) | grep -cvE '^(KILL|STOP|TSTP)$')
((all == ${#ending[@]} + ${#harmless[@]} - 31)) || fail "a signal is left out: $all"
start
for signal in "${harmless[@]}"; do
  kill -s "$signal" "$daemon"
  kill -s 0 "$daemon" || fail "SIG$signal: $(cat daemon.log)"
done
drive
kill -s TSTP "$daemon"
sleep 0.3
kill -s CONT "$daemon"
drive
kill "$daemon"
ends_saved "the harmless ones"
for signal in "${ending[@]}"; do
  start
  kill -s "$signal" "$daemon"
  ends_saved "SIG$signal"
done

# SIGHUP saves, and mapping goes on.
start
kill -s HUP "$daemon"
await bash -c '(($(jq ".layers[0].commits" <(splinemap info live.splinemap --json)) > 5))'
drive
# Who is impatient loses nothing.
for _ in {1..20}; do
  kill -s INT "$daemon" 2> /dev/null || break
  kill -s TERM "$daemon" 2> /dev/null || break
done
ends_saved "Ctrl-C again and again"

# A file that may not grow: said, and saved once it may.
start
prlimit --pid "$daemon" --fsize=1024:unlimited
kill -s HUP "$daemon"
await grep -q "the map is not saved" daemon.log
drive
prlimit --pid "$daemon" --fsize=unlimited:unlimited
kill "$daemon"
ends_saved "SIGXFSZ"

# A log that nobody reads any more.
rm -f live.splinemap*
mkfifo log
splinemapd --config mapping.textproto 2> log &
daemon=$!
head -n 1 log > /dev/null
await splinemap watch --once --timeout 2
drive
before=$(mapped)
kill -s HUP "$daemon"
drive
kill "$daemon"
wait "$daemon" || fail "a log without a reader: status $?"
(($(commits_in_file) > before)) || fail "a log without a reader: $(commits_in_file) scans are saved"

# A terminal that is gone, with everything in it.
rm -f live.splinemap*
mkfifo in
script -qfc "splinemapd --config mapping.textproto & echo \$! > pid; wait" typescript < in > /dev/null &
terminal=$!
exec 9> in
await splinemap watch --once --timeout 2
drive
kill -9 "$terminal"
wait "$terminal" 2> /dev/null || true
exec 9>&-
sleep 0.5
before=$(mapped)
drive
daemon=$(cat pid)
kill "$daemon"
await bash -c "! kill -0 $daemon"
(($(commits_in_file) > before)) || fail "a terminal that is gone: $(commits_in_file) scans are saved"
