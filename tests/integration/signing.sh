#!/usr/bin/env bash
# Two daemons and a laptop with keys, and a stranger without, on a bus of their own: who is believed,
# what the stranger can do with forged and recorded messages, and what is said of it.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

# Keys: a folder each, the same list of those that are trusted.
declare -A key
for who in robot base laptop viewer; do
  expect 0 splinemap keys new "$who.keys"
  key[$who]=$(< out)
  [[ $(stat -c %a "$who.keys/own.key") == 600 ]] || fail "others can read $who.keys/own.key"
done
expect 1 splinemap keys new robot.keys
expect_text "is there already" err
expect 1 splinemapd --keys robot.keys --no-sensors --name robot --map refused.splinemap
expect_text "splinemap keys trust robot.keys robot ${key[robot]} --maps robot" err
for who in robot base laptop viewer; do
  expect 0 splinemap keys trust "$who.keys" robot "${key[robot]}" --maps robot
  expect 0 splinemap keys trust "$who.keys" base "${key[base]}" --maps base --answers --decides
  expect 0 splinemap keys trust "$who.keys" laptop "${key[laptop]}" --decides
  expect 0 splinemap keys trust "$who.keys" viewer "${key[viewer]}"
done
cmp robot.keys/trusted base.keys/trusted || fail "the lists differ"
expect 2 splinemap keys trust robot.keys odd 1234
expect_text "64 hexadecimal digits" err
chmod 644 viewer.keys/own.key
expect 1 splinemap query --live 0 0 --keys viewer.keys
expect_text "chmod 600 viewer.keys/own.key" err
chmod 600 viewer.keys/own.key

# The robot's map, before the base comes; and all that is said of it.
splinemap simulate office.lcmlog 2> /dev/null
splinemap build office.lcmlog robot.splinemap --name robot --scan LASER --pose POSE > /dev/null 2>&1
lcm-logger -f all.lcmlog > logger.log 2>&1 &
logger=$!
declare -A daemon
start() {  # WHO [FLAG..]
  splinemapd --map "$1.splinemap" --name "$1" "${@:2}" 2> "$1.log" &
  daemon[$1]=$!
}
start robot --keys robot.keys --scan LASER --pose POSE
start base --keys base.keys --no-sensors
state() {  # of the robot's layer, as the base has it
  splinemap layers --live --keys laptop.keys --robot base --timeout 1.5 --json |
    jq -r '.[] | select(.name == "robot") | '"$1"
}
is() { [[ $(state "$1") == "$2" ]]; }
hash=$(splinemap layers robot.splinemap --json | jq -r '.[] | select(.name == "robot") | .hash')
await is .hash "$hash"

# Clients with keys follow, ask and command, as far as they may.
expect 0 splinemap snapshot all.splinemap --keys viewer.keys
expect 0 splinemap diff all.splinemap robot.splinemap --robot robot || true
expect 0 splinemap query --live 1 1 --keys viewer.keys --robot base
expect 1 splinemap layer mute --live robot --keys viewer.keys --robot base
expect_text "signed by viewer, whose key may not decide" err
expect 1 splinemap layer mute --live robot --keys laptop.keys --robot robot
expect_text "the key of robot may not decide about layers" err
expect 0 splinemap layer mute --live robot --keys laptop.keys --robot base
is .muted true || fail "not muted: $(state .)"
expect 0 splinemap save --keys laptop.keys --robot robot
expect 0 splinemap layer unmute --live robot --keys laptop.keys --robot base

# The stranger has no key: nobody does what it says, and it is told why.
for command in "layer mute --live robot" "layer remove --live robot" "layer place --live robot 1 2 3" \
  "clear --robot robot" "save"; do
  # shellcheck disable=SC2086  # words
  expect 1 splinemap $command
  expect_text "not signed" err
done
expect 1 splinemap snapshot strange.splinemap --timeout 3  # without pulls that are answered
mkdir strange.keys
splinemap keys new strange.keys > stranger.key
for who in robot base laptop; do
  grep -v '^#' laptop.keys/trusted | grep "^$who " >> strange.keys/trusted
done
expect 0 splinemap keys trust strange.keys stranger "$(< stranger.key)" --maps '*' --answers --decides
expect 1 splinemap clear --robot robot --keys strange.keys --timeout 3
expect_text "not trusted here: splinemap keys trust" err

# A stranger who says that it is the robot, in a greater session, empty; who pretends that it has
# removed the robot's layer; and who sends all again that was recorded, commands too.
start strange --keys strange.keys --scan A --pose B
kill "${daemon[strange]}"
wait "${daemon[strange]}" || true
sqlite3 strange.splinemap 'SELECT 1' > /dev/null
cp robot.splinemap forged.splinemap
splinemapd --map forged.splinemap --name robot --scan A --pose B --follow '*' 2> forged.log &
daemon[forged]=$!
sleep 6
kill "${daemon[forged]}"
kill "$logger"
wait "$logger" || true
for again in 1 2; do
  lcm-logplayer -s 4 all.lcmlog > /dev/null 2>&1 || fail "no log was played, $again"
done
sleep 2
is .hash "$hash" || fail "the stranger changed the map: $(state .)"
is .muted false || fail "a recorded command was taken: $(state .)"
is .origin "$(splinemap layers robot.splinemap --json | jq -r '.[] | select(.name == "robot") | .origin')" ||
  fail "the robot became another layer"
splinemap watch --once --json > status
for who in robot base; do
  grep -q "messages about layers not signed" "$who.log" || fail "$who says nothing: $(cat "$who.log")"
done
grep -q "refused 1 commands not signed" robot.log base.log || fail "nothing of commands"

# The robot is gone, and recordings of it bring nothing back: the base answers.
kill "${daemon[robot]}"
wait "${daemon[robot]}" || fail "robot: $(cat robot.log)"
sleep 4
lcm-logplayer -s 4 all.lcmlog > /dev/null 2>&1 &
expect 0 splinemap snapshot later.splinemap --keys viewer.keys --robot robot
expect 0 splinemap diff later.splinemap all.splinemap
kill "${daemon[base]}"
wait "${daemon[base]}" || fail "base: $(cat base.log)"

# Whoever hears nobody whom it trusts says so.
start base --keys base.keys --no-sensors
start robot --scan LASER --pose POSE
await grep -q "not signed: the sender needs --keys, and its key has to be trusted here; none was heard" base.log
