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
    jq -r '.[0].layers[] | select(.name == "robot") | '"$1"
}
is() { [[ $(state "$1") == "$2" ]]; }
of_robot() { splinemap layers "$1" --json | jq -r ".[] | select(.name == \"robot\") | $2"; }  # FILE FIELD
hash=$(of_robot robot.splinemap .hash)
await is .hash "$hash"

# Clients with keys follow, ask and command, as far as they may.
expect 0 splinemap snapshot all.splinemap --keys viewer.keys
[[ $(of_robot all.splinemap .hash) == "$hash" ]] || fail "the snapshot is another map"
expect 0 splinemap query --live 1 1 --keys viewer.keys --robot base
expect 1 splinemap layer mute --live robot --keys viewer.keys --robot base
expect_text "signed by viewer, whose key may not decide" err
expect 1 splinemap layer mute --live robot --keys laptop.keys --robot robot
expect_text "the key of robot may not decide about layers" err
lcm-logger -f mute.lcmlog > logger.log 2>&1 &
mute_logger=$!
await test -s mute.lcmlog
expect 0 splinemap layer mute --live robot --keys laptop.keys --robot base
is .muted true || fail "not muted: $(state .)"
kill "$mute_logger"
wait "$mute_logger" || true
expect 0 splinemap save --keys laptop.keys --robot robot
expect 0 splinemap layer unmute --live robot --keys laptop.keys --robot base

# The stranger has no key: nobody does what it says, and it is told why.
for command in "layer mute --live robot" "layer remove --live robot" "clear --robot robot" "save"; do
  # shellcheck disable=SC2086  # words
  expect 1 splinemap $command
  expect_text "not signed" err
done
expect 1 splinemap snapshot strange.splinemap --timeout 2  # without pulls that are answered
expect 0 splinemap keys new strange.keys
stranger=$(< out)
cp laptop.keys/trusted strange.keys/trusted
expect 0 splinemap keys trust strange.keys stranger "$stranger" --maps '*' --answers --decides
splinemap clear --robot robot --keys strange.keys 2> clear.err &  # until its deadline
clearing=$!

# It says that it is the robot, in a greater session, and sends again what was recorded, the command
# that muted the robot, too.
expect 0 splinemap snapshot forged.splinemap --keys viewer.keys --robot robot  # continued as session 3
splinemapd --map forged.splinemap --name robot --scan A --pose B 2> forged.log &
forged=$!
sleep 3
kill "$forged"
wait "$forged" || true
kill "$logger"
wait "$logger" || true
for log in mute all; do
  lcm-logplayer -s 8 "$log.lcmlog" > player.log 2>&1 || fail "$log was not played: $(cat player.log)"
done
sleep 2
is .hash "$hash" || fail "the stranger changed the map: $(state .)"
is .muted false || fail "a recorded command was taken: $(state .)"
is .origin "$(of_robot robot.splinemap .origin)" || fail "the robot became another layer"
is .session_number 2 || fail "the robot is in another session: $(state .)"
for who in robot base; do
  grep -q "messages about layers not signed" "$who.log" || fail "$who says nothing: $(cat "$who.log")"
done
grep -q "commands not signed" robot.log base.log || fail "nothing is said of commands"
await bash -c "splinemap watch --once --json | jq -e '.problems.disbelieved_messages > 0'"

# The robot is gone, and recordings of it bring nothing back: the base answers.
kill "${daemon[robot]}"
wait "${daemon[robot]}" || fail "robot: $(cat robot.log)"
sleep 4
lcm-logplayer -s 4 all.lcmlog > player.log 2>&1 &
player=$!
expect 0 splinemap snapshot later.splinemap --keys viewer.keys --robot robot
[[ $(of_robot later.splinemap .hash) == "$hash" ]] || fail "the base answers with another map"
wait "$clearing" && fail "a stranger with a key of its own cleared the map"
grep -q "not trusted here: splinemap keys trust" clear.err || fail "$(cat clear.err)"
kill "$player" "${daemon[base]}"
wait "$player" || true
wait "${daemon[base]}" || fail "base: $(cat base.log)"

# Whoever hears nobody whom it trusts says so.
start base --keys base.keys --no-sensors
start robot --scan LASER --pose POSE
await grep -q "not signed: the sender needs --keys, and its key has to be trusted here; none was heard" base.log
