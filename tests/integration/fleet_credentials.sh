#!/usr/bin/env bash
# Who may do what in a fleet: three NATS servers and one at the edge, as deploy/fleet sets them up,
# and credentials that are right, wrong, of others, expired, removed and abused.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"
credentials=$top/deploy/fleet/credentials.sh

# --- A fleet, and what the scripts refuse.
expect 0 "$credentials" new fleet
for k in 1 2 3; do expect 0 "$credentials" server fleet "node-$k" localhost 127.0.0.1; done
expect 0 "$credentials" server fleet site localhost
expect 0 "$credentials" worker fleet worker
expect 0 "$credentials" operator fleet operator
expect 0 "$credentials" viewer fleet viewer
for who in robot-1 robot-2 'röbot 3' leaver; do expect 0 "$credentials" robot fleet "$who"; done
expect 1 "$credentials" viewer fleet robot-1
expect_text "robot-1 is there already, as a robot" err
expect 1 "$credentials" robot fleet servers
expect_text "is the folder of the servers" err
expect 1 "$credentials" robot nowhere robot-1
expect_text "nowhere is no fleet" err
expect 1 "$credentials" remove fleet nobody
expect_text "fleet has no nobody" err
expect 2 "$credentials" robot fleet
for file in ca.key servers.password robot-1/own.key servers/node-1/own.key; do
  [[ $(stat -c %a "fleet/$file") == 600 ]] || fail "others can read fleet/$file"
done
expect 1 "$top/deploy/fleet/server.sh" fleet node-4
expect_text "credentials.sh server fleet node-4" err

# server NAME PORT [FLAG..]: until the end.
declare -A server
server() {
  expect 0 "$top/deploy/fleet/server.sh" fleet "$1" --port "$2" "${@:3}"
  [[ $(stat -c %a "fleet/servers/$1/server.conf") == 600 ]] || fail "others can read the password"
  (cd "fleet/servers/$1" && exec nats-server -c server.conf > log 2>&1) &
  server[$1]=$!
}
server node-1 4601 --peer localhost:4602 --peer localhost:4603
server node-2 4602 --peer localhost:4601 --peer localhost:4603
server node-3 4603 --peer localhost:4601 --peer localhost:4602
server site 4604 --leaf-of localhost:4601 --leaf-of localhost:4602
nats-server -a 127.0.0.1 -p 4605 > plain.log 2>&1 &
read_users() { for name in "${!server[@]}"; do kill -HUP "${server[$name]}"; done; }

entry() { fleet_entry --fleet "nats://localhost:$port" "$@"; }
as() { entry --credentials "fleet/$1" "${@:2}"; }
port=4601
await as worker make --replicas 3

# --- What each may do.
digest=layers.robot-1.0000000000000001.digest
settings=settings.robot-1.0000000000000001
expect 0 as robot-1 put "$digest" "of robot-1"
expect 0 as 'r=c3=b6bot=203' put layers.r=c3=b6bot=203.0000000000000001.digest "of röbot 3"
expect 0 as operator put "$settings" muted
expect 0 as operator put layers.robot-2.0000000000000001.digest removed
expect 0 as worker put map "of a worker"
for who in robot-2 viewer operator worker; do
  expect 0 as "$who" get "$digest"
  expect_text "of robot-1" out
done
expect 0 as viewer list 'layers.>'
(($(wc -l < out) == 3)) || fail "a viewer lists: $(< out)"
mkfifo until
as worker answer splinemap.map.ask.00 "of the worker" < until 2> answer.log &
exec 7> until
await grep -q answering answer.log
expect 0 as viewer ask splinemap.map.ask.00 what
expect_text "of the worker" out

# --- What each may not do. Side by side: servers do not tell it in their answer, which is awaited.
# refused TEXT COMMAND..
all_refused=()
refused() {
  (
    work=$work/refused-$BASHPID
    mkdir "$work"
    expect 1 "${@:2}"
    expect_text "$1" err
  ) &
  all_refused+=($!)
}
check_refused() {
  local job
  ((${#all_refused[@]})) || fail "nothing was refused"
  for job in "${all_refused[@]}"; do wait "$job" || fail "see above"; done
  all_refused=()
}
not_allowed="PERMISSION_DENIED: to write: the servers do not allow it"
refused "$not_allowed" as robot-2 put "$digest" forged
refused "$not_allowed" as robot-2 put "$settings" forged
refused "$not_allowed" as robot-2 put map forged
refused "Permissions Violation for Publish" as robot-2 put-new "$digest" forged
refused "Permissions Violation for Publish" as robot-2 --fleet-map other make
refused "$not_allowed" as viewer put "$digest" forged
refused "$not_allowed" as operator put map forged

# --- Credentials that are none.
refused "PERMISSION_DENIED: the servers at nats://localhost:4601 want credentials" entry get map
refused "NOT_FOUND: fleet/nobody/ca.pem is not there" as nobody get map
refused "PERMISSION_DENIED: fleet/robot-1/own.pem has expired on 20" \
  faketime '+2 years' fleet_entry --fleet nats://localhost:4601 --credentials fleet/robot-1 get map
refused "is valid from" \
  faketime '-2 years' fleet_entry --fleet nats://localhost:4601 --credentials fleet/robot-1 get map
expect 0 "$credentials" new others
expect 0 "$credentials" robot others robot-1
refused "are not of the fleet of others/robot-1/ca.pem" entry --credentials others/robot-1 get map
cp -r others/robot-1 foreign
cp fleet/ca.pem foreign/
refused "ended the connection: foreign/own.pem is of another fleet" \
  entry --credentials foreign get map
cp -r fleet/robot-1 no-pair
cp fleet/robot-2/own.key no-pair/
refused "PERMISSION_DENIED: the credentials in no-pair cannot be used" \
  entry --credentials no-pair get map
refused "or name other hosts" \
  fleet_entry --fleet "nats://$(hostname):4601" --credentials fleet/robot-1 get map
port=4605
refused "do not use TLS" as robot-1 get map
port=4606
refused "UNAVAILABLE: no NATS server answers at nats://localhost:4606" as robot-1 get map
port=4601
check_refused

# --- What a robot or viewer may send, with ends that were not meant.
lines() { expect 0 python3 "$top/tests/support/nats_lines.py" localhost 4601 "fleet/$1" "${@:2}"; }
# shellcheck disable=SC2016  # the servers' subjects
own='$KV.splinemap_map.layers.robot-2.0000000000000001'
# Replies that belong to others, their requests, and all that is written.
# shellcheck disable=SC2016
for subject in '_INBOX.>' '_INBOX.robot-1.>' 'splinemap.map.ask.>' '$KV.>'; do
  lines robot-2 "SUB $subject 1"
  expect_text "Permissions Violation for Subscription to \"$subject\"" out
done
# One entry that removes all others.
lines robot-2 "SUB _INBOX.robot-2.a 1" \
  "HPUB $own.a _INBOX.robot-2.a 30 31|NATS/1.0|Nats-Rollup: all||x"
expect_text "rollup not permitted" out
# An acknowledgement that asks for a purge; an answer of a worker that is stored, with its rights.
lines robot-2 "PUB $own.b \$JS.API.STREAM.PURGE.KV_splinemap_map 1|x"
lines viewer "PUB splinemap.map.ask.00 \$KV.splinemap_map.$settings 1|x"
expect 0 as viewer get "$digest"
expect 0 as viewer get "$settings"
expect_text muted out
# An entry that is delivered to the workers, as if it were one of their own messages.
consumer='{"stream_name":"KV_splinemap_map","config":
  {"deliver_subject":"splinemap.map.workers","ack_policy":"none"}}'
mkfifo until-2
as worker listen splinemap.map.workers < until-2 > heard 2> listen.log &
exec 8> until-2
await grep -q listening listen.log
lines viewer "PUB \$JS.API.CONSUMER.CREATE.KV_splinemap_map _INBOX.viewer.a ${#consumer}|$consumer"
lines robot-2 "PUB $own.d 9|delivered"
expect 0 as worker tell splinemap.map.workers "of a worker"
await grep -q "of a worker" heard
! grep -q delivered heard || fail "an entry was taken for a message"
# An acknowledgement that is stored in place of another's entry. This is not prevented: README.md of
# deploy/fleet says so. It is no record, and its owner writes it again.
lines robot-2 "PUB $own.c \$KV.splinemap_map.$digest 1|x"
expect 0 as viewer get "$digest"
expect_text '{"stream":"KV_splinemap_map"' out
expect 0 as robot-1 put "$digest" "of robot-1"
# A robot that takes itself for a server.
for other_port in 6601 7801; do
  expect 0 python3 "$top/tests/support/nats_lines.py" localhost "$other_port" fleet/robot-1 PING
  expect_text "Authorization Violation" out
done

# --- At the edge: the same, through another server.
port=4604
expect 0 as robot-1 put "$digest" "from the site"
refused "$not_allowed" as robot-2 put "$digest" forged
expect 0 as viewer get "$digest"
expect_text "from the site" out
expect 0 as viewer list 'layers.robot-1.>'
expect_text "$digest" out
port=4601

# --- Removed, while it writes; renewed; and made again, which does not bring the old one back.
cp -r fleet/leaver leaver
entry --credentials leaver keep layers.leaver.0000000000000001.digest here > kept 2> keep.log &
keeper=$!
await grep -q OK keep.log
expect 0 "$credentials" remove fleet leaver
read_users
wait "$keeper" && fail "a credential that was removed goes on"
grep -q "do not know the credentials in leaver" kept || fail "no reason: $(< kept)"
expect 0 "$credentials" robot fleet leaver
expect 0 "$credentials" renew fleet robot-1 --days 800
read_users
expect 0 "$credentials" list fleet
expect_text leaver out
await as leaver put layers.leaver.0000000000000001.digest again
expect 1 entry --credentials leaver get map
expect_text "PERMISSION_DENIED: the servers at nats://localhost:4601 do not know" err
expect 0 faketime '+2 years' openssl verify -CAfile fleet/ca.pem fleet/robot-1/own.pem
expect 0 as robot-1 put "$digest" "of robot-1, renewed"
check_refused
exec 7>&- 8>&-
echo "fleet_credentials: all is well"
