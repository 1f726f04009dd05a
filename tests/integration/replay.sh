#!/usr/bin/env bash
# Replays as people make them: faster, paused, looped, with seeking, and of logs that hold splinemap's
# own messages. Each gives the map of the offline build of the same messages.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

start() {
  rm -f live.splinemap
  splinemapd --map live.splinemap --name robot --scan LASER --pose POSE 2> daemon.log &
  daemon=$!
  await splinemap watch --once --timeout 2
}

received() {
  splinemap watch --once --json --timeout 2 > status.json
  (($(jq .messages_received status.json) >= $1))
}

# finish LOG: when all scans and poses of LOG were received, the map is that of its build.
finish() {
  local log=$1 messages
  expect 0 splinemap doctor "$log" --json --scan LASER --pose POSE
  messages=$(jq '[.channels[] | select(.name == "LASER" or .name == "POSE") | .messages] | add' out)
  await received "$messages"
  kill "$daemon"
  wait "$daemon" || fail "the daemon failed: $(cat daemon.log)"
  [[ $(jq .messages_received status.json) == "$messages" ]] || fail "received: $(cat status.json)"
  expect 0 splinemap build "$log" offline.splinemap --name robot --scan LASER --pose POSE --force
  expect 0 splinemap diff live.splinemap offline.splinemap
  echo "$(basename "$log"): $messages messages, $(jq .scans_mapped status.json) scans mapped, $(cat out)"
}

warnings() { grep -c "warning.*$1" daemon.log || true; }

cat > room.world << 'EOT'
wall { x0_m: -3 y0_m: -2 x1_m: 5 y1_m: -2 }
wall { x0_m: 5 y0_m: -2 x1_m: 5 y1_m: 4 }
wall { x0_m: 5 y0_m: 4 x1_m: -3 y1_m: 2 }
waypoint { x_m: 0 } waypoint { x_m: 3 y_m: 1 } waypoint { x_m: 3 y_m: 2 } waypoint { x_m: 0 }
EOT
splinemap simulate room.world drive.lcmlog 2> /dev/null

echo "speeds"
for speed in 5 50; do
  start
  lcm-logplayer -s $speed drive.lcmlog > player.log
  finish drive.lcmlog
  [[ $(warnings '') == 0 ]] || fail "$(cat daemon.log)"
done

echo "a pause longer than scans wait for poses"
start
lcm-logplayer -s 5 drive.lcmlog > player.log &
player=$!
await received 100
kill -STOP "$player"
sleep 1.5
await received 100
paused=$(jq .messages_received status.json)
sleep 1
await received 100
[[ $(jq .messages_received status.json) == "$paused" ]] || fail "the player did not pause"
kill -CONT "$player"
wait "$player"
finish drive.lcmlog
((paused < $(jq .messages_received status.json))) || fail "the pause came after the end"
[[ $(warnings '') == 0 ]] || fail "$(cat daemon.log)"

echo "a loop"
start
for _ in {1..3}; do lcm-logplayer -s 50 drive.lcmlog > player.log; done
cat drive.lcmlog drive.lcmlog drive.lcmlog > looped.lcmlog
finish looped.lcmlog
[[ $(warnings '') == 1 && $(warnings 'jumped back') == 1 ]] || fail "said: $(cat daemon.log)"

# The parts of a drive as somebody sees them who seeks in lcm-logplayer-gui, in shares of the log. The
# player's clock goes on; the messages' own times jump.
cat > seek.py << 'EOT'
import struct, sys
source, target, *parts = sys.argv[1:]
data, events, at = open(source, "rb").read(), [], 0
while at < len(data):
    sizes = struct.unpack_from(">II", data, at + 20)
    end = at + 28 + sum(sizes)
    events.append(data[at + 20:end])
    at = end
with open(target, "wb") as out:
    number = 0
    for part in parts:
        begin, end = (int(float(share) * len(events)) for share in part.split("-"))
        for event in events[begin:end]:
            out.write(struct.pack(">IQQ", 0xEDA1DA01, number, 10000 * number) + event)
            number += 1
EOT
echo "seeking"
python3 seek.py drive.lcmlog seeking.lcmlog 0.5-0.9 0.1-0.4 0.6-0.7 0.1-0.2 0.8-1
start
lcm-logplayer -s 20 seeking.lcmlog > player.log
finish seeking.lcmlog
[[ $(warnings 'jumped back') == 1 ]] || fail "said: $(cat daemon.log)"
# A seek costs no more than the scans around it.
[[ $(jq '.scans_mapped > 0.95 * .scans_received' status.json) == true ]] || fail "$(cat status.json)"

echo "a log that holds what the daemon said"
start
lcm-logger --quiet --force recorded.lcmlog &
logger=$!
await test -s recorded.lcmlog  # the daemon's status
lcm-logplayer -s 5 drive.lcmlog > player.log
finish drive.lcmlog
kill -INT "$logger"
wait "$logger" || true
expect 0 splinemap doctor recorded.lcmlog --json --scan LASER --pose POSE
[[ $(jq '.channels[] | select(.name == "SPLINEMAP_STATUS") | .messages > 2' out) == true ]] ||
  fail "recorded: $(cat out)"
start
splinemap info live.splinemap --json > before.json
lcm-logplayer -s 10 recorded.lcmlog > player.log
finish recorded.lcmlog
splinemap build drive.lcmlog offline.splinemap --name robot --force 2> /dev/null
expect 0 splinemap diff live.splinemap offline.splinemap
expect 0 splinemap info live.splinemap --json
identity='[.layers[] | [.name, .origin, .session_number]]'
[[ $(jq -c "$identity" before.json) == "$(jq -c "$identity" out)" ]] || fail "$(cat before.json out)"
[[ $(warnings '') == 1 && $(warnings 'there are two layers named robot') == 1 ]] || fail "$(cat daemon.log)"

# Some scans of the drive with as many beams as a scan may have, which LCM cuts into fragments.
cat > large.py << 'EOT'
import struct, sys
data, out, at = open(sys.argv[1], "rb").read(), open(sys.argv[2], "wb"), 0
while at < len(data):
    number, utime, name_size, size = struct.unpack_from(">QQII", data, at + 4)
    name = data[at + 28:at + 28 + name_size]
    message = data[at + 28 + name_size:at + 28 + name_size + size]
    at += 28 + name_size + size
    if name == b"LASER" and utime % 1000000 == 0:
        count = struct.unpack_from(">i", message, 16)[0]
        repeats = 16384 // count
        step = struct.unpack(">f", message[-4:])[0]
        beams = b"".join(message[k:k + 4] * repeats for k in range(20, 20 + 4 * count, 4))
        message = (message[:16] + struct.pack(">i", count * repeats) + beams +
                   message[20 + 4 * count:-4] + struct.pack(">f", step / repeats))
    out.write(struct.pack(">IQQII", 0xEDA1DA01, number, utime, name_size, len(message)))
    out.write(name + message)
EOT
echo "scans of several datagrams"
python3 large.py drive.lcmlog large.lcmlog
start
lcm-logplayer -s 5 large.lcmlog > player.log
finish large.lcmlog
[[ $(warnings '') == 0 ]] || fail "$(cat daemon.log)"
