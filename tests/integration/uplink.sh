#!/usr/bin/env bash
# splinemap-uplink between robots' daemons, each on a bus of its own (a UDP port), and a fleet: what
# goes up, what comes down, what people decide, what is refused, and how it ends.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

PATH=$PATH:/usr/sbin
if ! command -v nats-server > /dev/null; then
  echo "uplink: skipped, nats-server is not installed"
  exit 0
fi
hub=nats://127.0.0.1:4520

declare -A process=()
start_server() {
  rm -f server.log
  nats-server -a 127.0.0.1 -p 4520 -js -sd store > server.log 2>&1 &
  process[server]=$!
  await grep -q "Server is ready" server.log
}
# finish WHAT [SIGNAL]: it ends within 2 s, with status 0 or, where servers keep it waiting, by SIGTERM.
finish() {
  local pid=${process[$1]} begin=$EPOCHREALTIME status=0
  unset "process[$1]"
  kill "-${2:-TERM}" "$pid"
  wait "$pid" 2> /dev/null || status=$?
  [[ ${2:-} != KILL ]] || return 0
  ((status == 0 || status == 143)) || fail "$1 ended with status $status: $(cat "$1.log")"
  [[ $1 != uplink* ]] || (((${EPOCHREALTIME/./} - ${begin/./}) < 2000000)) ||
    fail "$1 took longer than 2 s to end: $(cat "$1.log")"
}
bus_of() { echo "udpm://239.255.76.67:$((7700 + $1))?ttl=0&recv_buf_size=2000000"; }
# start_robot K NAME [FLAG..]: on the bus K, or $bus, and NAME.splinemap.
start_robot() {
  rm -f "robot$1.log"
  splinemapd --scan LASER --pose POSE --name "$2" --lcm-url "$(bus_of "${bus:-$1}")" "${@:3}" 2> "robot$1.log" &
  process[robot$1]=$!
  await grep -q "listening on POSE" "robot$1.log"
}
# start_uplink K [FLAG..]
start_uplink() {
  rm -f "uplink$1.log"
  splinemap-uplink --fleet $hub --lcm-url "$(bus_of "$1")" --interval-s 0.3 "${@:2}" 2> "uplink$1.log" &
  process[uplink$1]=$!
}
says() { await grep -q -- "$2" "$1.log"; }  # WHO TEXT
start_play() {  # K SPEED LOG
  lcm-logplayer -s "$2" -l "$(bus_of "$1")" "$3" > /dev/null 2>&1 &
  process[player]=$!
}
end_play() {
  wait "${process[player]}" || fail "it was not played to its end"
  unset "process[player]"
}
# What has to be the same wherever a layer is.
one_layer() { jq -c --arg name "$1" '[.[] | select(.name == $name and .tiles > 0) | [.origin, .session_number, .commits, .hash]] | sort'; }
in_file() { splinemap layers "$1.splinemap" --json 2> /dev/null | one_layer "$2"; }  # FILE NAME
in_fleet() { splinemap layers --fleet $hub --json --timeout 5 2> /dev/null | one_layer "$1"; }
is_up() { [[ $(in_file "$1" "$1") == "$(in_fleet "$1")" && $(in_fleet "$1") != '[]' ]]; }  # NAME
# live K NAME FIELD: of a layer, as the daemon of robot K has it.
robot=([1]=one [2]=two)
live() {
  splinemap layers --live --lcm-url "$(bus_of "$1")" --robot "${robot[$1]}" --timeout 1 --json 2> /dev/null |
    jq -r ".[0].layers[] | select(.name == \"$2\") | $3"
}
is_live() { [[ $(live "$1" "$2" "$3") == "$4" ]]; }
# As its first report says, and its last line.
sent_at_first() { sed -nE 's/.*sent ([0-9]+) blocks.*/\1/p' "$1.log" | head -n 1; }
sent() { tail -n 1 "$1.log" | sed -nE 's/.*sent ([0-9]+) blocks.*/\1/p'; }

splinemap simulate drive.lcmlog --rate 10 --pose-rate 20 2> /dev/null
expect 0 splinemap build drive.lcmlog built.splinemap --name one
expect 0 splinemap build drive.lcmlog far.splinemap --name far --frame 500,500,0

# --- it ends, whatever it waits for
start_uplink 1
says uplink1 "looking for the fleet"
sleep 0.3
finish uplink1
start_server
start_uplink 1
sleep 0.3  # nobody on the bus
finish uplink1
start_robot 1 one
start_uplink 1
says uplink1 "splinemap-fleet-worker"
finish uplink1 INT
splinemap-fleet-worker --fleet $hub 2> worker.log &
process[worker]=$!
says worker "answers for 64 of 64 parts"

# --- what the robot maps is in the fleet; a server that is away delays it, and no more than that
start_uplink 1 --robot one
start_play 1 20 drive.lcmlog
says uplink1 "^one: commit [0-9]* here, [0-9]* in the fleet"
finish server KILL
before=$(live 1 one .commits)
end_play
says uplink1 "is lost; it is looked for again"
await is_live 1 one .hash "$(splinemap layers built.splinemap --json | jq -r '.[0].hash')"
commits=$(($(live 1 one .commits) - before))
start_server
says uplink1 "all is well again"
await is_up one
finish uplink1
blocks=$(($(sent uplink1) - $(sent_at_first uplink1)))
((commits > 100 && blocks > 0 && blocks < commits / 4)) ||
  fail "of $commits commits without a server, $blocks blocks were sent: $(cat uplink1.log)"
start_uplink 1
says uplink1 "^one: commit"
finish uplink1
[[ $(sent uplink1) == 0 ]] || fail "what the fleet has was sent again: $(cat uplink1.log)"
echo "after $commits commits without a server $blocks blocks were sent"

# --- copies of the map file
start_uplink 1 --map one.splinemap --max-kb-per-s 10000
await fleet_file $hub map one copy.splinemap
expect 0 splinemap backup one.splinemap backup.splinemap
for file in copy backup; do sqlite3 "$file.splinemap" .dump > "$file.sql"; done
cmp copy.sql backup.sql || fail "the copy of the map file has another content"
finish uplink1
start_uplink 1 --map one.splinemap --max-kb-per-s 1
says uplink1 "^one: commit"
finish uplink1
! compgen -G '*.part*' > /dev/null || fail "it left $(ls)"

# --- servers that do not answer
start_uplink 1
says uplink1 "^one: commit"
kill -STOP "${process[server]}"
start_play 1 50 drive.lcmlog
sleep 1
finish uplink1
start_uplink 1
sleep 0.3
finish uplink1
kill -CONT "${process[server]}"
end_play

# --- another robot, far away for the bus, has the layer by the fleet, also while it changes
start_uplink 1
fleet_put far.splinemap $hub map
start_robot 2 two --follow '*'
start_uplink 2 --follow '*' --region -5,-5,30,30
has_one() { [[ $(in_file two one) == "$(in_file one one)" && $(in_file two one) != '[]' ]]; }
await has_one
start_play 1 30 drive.lcmlog
for _ in {1..4}; do live 2 one .commits; done > seen
end_play
(($(sort -u seen | wc -l) >= 3)) || fail "two does not follow one while it drives: $(cat seen)"
await has_one
await is_up one
[[ -z $(live 2 far .name) ]] || fail "a layer beside the region came: $(live 2 far .)"
finish uplink2
grep -q "1 layers of others" uplink2.log || fail "of others: $(cat uplink2.log)"
start_uplink 2 --follow '*'
await is_live 2 far .name far
finish uplink2
start_uplink 2 --follow '*' --region -5,-5,30,30

# --- people decide in the fleet
expect 0 splinemap layer mute one --fleet $hub
await is_live 2 one '[.muted, .in_sum] | tostring' '[true,false]'
await is_live 1 one .muted true
expect 0 splinemap layer unmute one --fleet $hub
await is_live 2 one .in_sum true
before=$(live 1 one .session_number)
expect 0 splinemap layer remove one --fleet $hub
is_begun() { [[ $(live 1 one '.tiles == 0 and .session_number > '"$before") == true ]]; }
await is_begun
for k in 1 2; do
  start_play $k 60 drive.lcmlog
  end_play
done
await is_up one
await has_one
[[ $(in_fleet one | jq '.[0][1] > '"$before") == true ]] || fail "the fleet has $(in_fleet one)"

# --- older copies of map files, while an uplink runs (one), and before it starts (two)
await is_up two
for name in one two; do expect 0 splinemap backup $name.splinemap older_$name.splinemap; done
for _ in 1 2; do  # sessions that the copies know nothing of
  finish robot1
  finish robot2
  start_robot 1 one
  start_robot 2 two --follow '*'
  await is_up one
  await is_up two
done
finish robot1
finish robot2
finish uplink2
declare -A session
for name in one two; do
  session[$name]=$(in_file $name $name | jq '.[0][1]')
  rm -f $name.splinemap*
  mv older_$name.splinemap $name.splinemap
done
start_robot 1 one
start_robot 2 two --follow '*'
start_uplink 2 --follow '*' --region -5,-5,30,30
says uplink2 "its map file is an older copy"
is_later() { [[ $(in_file "$1" "$1" | jq '.[0][1] > '"${session[$1]}") == true ]] && is_up "$1"; }
await is_later one
await is_later two
await has_one

# --- while a robot is heard on the bus nothing else is believed of it; when it has gone, the fleet
finish robot1
finish uplink1
cp one.splinemap moved.splinemap
bus=2 start_robot 5 one
await is_live 2 one .state live
for _ in 1 2; do  # two sessions elsewhere
  start_robot 6 one --map moved.splinemap
  finish robot6
done
expect 0 fleet_put moved.splinemap $hub map
sleep 1
[[ $(live 2 one .session_number) == "$(in_file one one | jq '.[0][1]')" ]] || fail "one was heard, and is not believed"
finish robot5 KILL
has_moved() { [[ $(in_file two one) == "$(in_file moved one)" ]]; }
await has_moved
rm -f one.splinemap*
mv moved.splinemap one.splinemap
start_robot 1 one
start_uplink 1

# --- two robots with copies of one file; it takes until one looks
finish robot1
cp one.splinemap twin.splinemap
start_robot 1 one
start_robot 3 one --map twin.splinemap
start_uplink 3

# --- another knot interval
printf 'method { knot_interval_m: 0.1 }\n' > coarse.textproto
start_robot 4 coarse --config coarse.textproto
start_uplink 4
says uplink4 "the robot's map has a knot interval of 0.1 m .*, the fleet's has a knot interval of 0.05 m "
finish uplink4
finish robot4
[[ $(in_fleet coarse) == '[]' ]] || fail "the coarse map is in the fleet"

# --- signed
finish robot2
finish uplink2
for who in robot bridge; do
  expect 0 splinemap keys new "$who.keys"
  cp out "$who.key"
done
for who in robot bridge; do
  expect 0 splinemap keys trust "$who.keys" signed "$(< robot.key)" --maps signed
  expect 0 splinemap keys trust "$who.keys" bridge "$(< bridge.key)" --answers
done
start_robot 2 signed --follow far --keys robot.keys
start_uplink 2 --follow far
says robot2 "not signed: the sender needs --keys"
[[ $(in_file signed far) == '[]' ]] || fail "a layer came from somebody without a key"
finish uplink2
start_uplink 2 --follow far --keys bridge.keys
has_far() { [[ $(in_file signed far) == "$(in_file far far)" ]]; }
await has_far
start_play 2 60 drive.lcmlog
end_play
await is_up signed

await grep -q "two robots have copies of one map file" uplink1.log uplink3.log
both=$(in_file one one; in_file twin one)
await grep -qxF "$(in_fleet one)" <<< "$both"
for who in "${!process[@]}"; do [[ $who == server ]] || finish "$who"; done
! compgen -G '*.part*' > /dev/null || fail "it left $(ls)"
