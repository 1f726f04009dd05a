#!/usr/bin/env bash
# The daemon from its unit, in a system that is its own: the commands of the blocks marked
# "sh systemd", a drive, a killed and a hanging daemon. clean_debian.sh runs it.
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

status() { splinemap watch --once --json --timeout 3; }
main_pid() { systemctl show --property MainPID --value splinemapd@robot-1; }
commands_of() {
  awk '/^```/ { inside = /^```sh systemd/; next } inside { sub(/ +#.*/, "") } inside && NF' "$top/$1"
}
run_commands_of() {
  local command
  while read -r command <&3; do
    expect 0 bash -c "cd $work; $command"
    echo "unit: $command"
  done 3< <(commands_of "$1")
}

splinemap simulate drive.lcmlog 2> /dev/null
run_commands_of deploy/README.md
await bash -c 'splinemap watch --once --timeout 3'
lcm-logplayer -s 20 drive.lcmlog > /dev/null
has_mapped() { (($(status | jq .scans_mapped) > 1000)); }
await has_mapped
expect 0 systemctl status splinemapd@robot-1
grep -qE 'Status: "[0-9]+ of [0-9]+ scans mapped' out || fail "no status: $(cat out)"
splinemap save 2> /dev/null
run_commands_of deploy/RUNBOOK.md
await bash -c 'splinemap watch --once --timeout 3'
expect 0 splinemap diff /var/lib/splinemap/robot-1.splinemap monday.splinemap

# Killed, and hanging: it is back, with the map.
first=$(main_pid)
kill -KILL "$first"
is_another() { (($(main_pid) != 0 && $(main_pid) != first)); }
await is_another
await splinemap watch --once --timeout 2
mkdir -p /run/systemd/system/splinemapd@.service.d
printf '[Service]\nWatchdogSec=3\nTimeoutAbortSec=2\n' > /run/systemd/system/splinemapd@.service.d/soon.conf
systemctl daemon-reload
systemctl restart splinemapd@robot-1
second=$(main_pid)
kill -STOP "$second"
await bash -c "! kill -0 $second"
await splinemap watch --once --timeout 2
(($(main_pid) != second)) || fail "a daemon that hangs is not restarted"
(($(status | jq .tiles) > 100)) || fail "the map is gone: $(status)"
journalctl --unit splinemapd@robot-1 --no-pager --output cat > journal.txt
grep -q "Watchdog timeout" journal.txt || fail "no watchdog: $(cat journal.txt)"
[[ $(journalctl --unit splinemapd@robot-1 --priority info..info --output cat --no-pager) == *"layer robot-1, session"* ]] ||
  fail "no levels: $(cat journal.txt)"
! grep -qE '^<[0-9]>' journal.txt || fail "levels in the text: $(cat journal.txt)"

# A mistake in the configuration is said and not tried again.
echo 'nonsense: 1' > /etc/splinemap/robot-2.textproto
systemctl start splinemapd@robot-2 && fail "it starts with nonsense"
[[ $(systemctl show --property NRestarts --value splinemapd@robot-2) == 0 ]] || fail "it is restarted"
journalctl --unit splinemapd@robot-2 --priority err --output cat --no-pager | grep -q 'robot-2.textproto:1' ||
  fail "no error: $(journalctl --unit splinemapd@robot-2 --no-pager)"

begin=${EPOCHREALTIME/./}
systemctl stop splinemapd@robot-1
took_ms=$(((${EPOCHREALTIME/./} - begin) / 1000))
((took_ms < 2000)) || fail "it took $took_ms ms to stop"
splinemap verify /var/lib/splinemap/robot-1.splinemap
systemd-analyze security splinemapd@robot-1 --no-pager | tail -n 1
echo "unit: all is well; stopped in $took_ms ms"
