#!/usr/bin/env bash
# A bus that is not there, goes away and comes back: nothing aborts, nothing that came is lost, and all
# go on. With a server (tcpq) and with multicast, in a network of their own.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

port=$((20000 + RANDOM % 10000))
multicast=$LCM_DEFAULT_URL
server_url=tcpq://127.0.0.1:$port
start_server() {
  java -cp /usr/share/java/lcm.jar lcm.lcm.TCPService "$port" > server.log 2>&1 &
  server=$!
  await bash -c "exec 3<> /dev/tcp/127.0.0.1/$port"
}
end_server() {
  kill "$server"
  wait "$server" || true
}
# said N TEXT: the daemon's log has the text that often.
said() { (($(grep -cF -- "$2" daemon.log) == $1)); }
mapped() { jq '.layers[0].commits' <(splinemap info live.splinemap --json); }
end_daemon() {
  kill "$daemon"
  wait "$daemon" || fail "the daemon: $(cat daemon.log)"
}

cat > mapping.textproto << 'END'
map: "live.splinemap" name: "robot" pose: "POSE" scan { channel: "LASER" }
service { save_interval_s: 0.5 }
END
splinemap simulate office.lcmlog 2> /dev/null

# Without a server each command waits for it, and ends with a sentence.
export LCM_DEFAULT_URL=$server_url
for command in "query 0 0 --live --timeout 0.5" "ray 0 0 0 --live --timeout 0.5" \
  "check 0 0 --radius 0.1 --live --timeout 0.5" "distance 0 0 --live --timeout 0.5" \
  "raster none.png --region -1,-1,1,1 --live --timeout 0.5" "watch --timeout 0.5" \
  "watch --once --json --timeout 0.5" "doctor --live --seconds 0.5" "layers --live --timeout 0.5" \
  "render --live --timeout 0.5" "export none --format csv --live --timeout 0.5" \
  "layer mute robot --live --timeout 0.5" "snapshot none.splinemap --timeout 0.5"; do
  read -ra words <<< "$command"
  expect 1 timeout 10 splinemap "${words[@]}"
  expect_text "the LCM server of $server_url is away: Connection refused; is it running?" err
done
for command in "splinemap bridge occupancy-grid" "splinemap-planner --start 0,0 --goal 1,1"; do
  read -ra words <<< "$command"
  expect 124 timeout 2 "${words[@]}"
  expect_text "the LCM server of $server_url is away: Connection refused; is it running?" err
done
expect 2 splinemap watch --lcm-url tcpq://robot:7700
expect_text "is no LCM URL" err

# The daemon may be there before the server.
splinemapd --config mapping.textproto 2> daemon.log &
daemon=$!
await said 1 "Connection refused"
sleep 3
said 1 "Connection refused" || fail "said more than once: $(cat daemon.log)"
start_server
await said 1 "works again"
await splinemap watch --once --timeout 2

# It ends while the robot drives. All that came is saved meanwhile, and the rest is mapped later.
lcm-logplayer -s 10 office.lcmlog > player.log 2>&1 &
player=$!
await bash -c 'splinemap watch --once --json --timeout 2 > status.json && (($(jq .scans_mapped status.json) > 300))'
end_server
await grep -q "broke off" daemon.log
sleep 2
before=$(mapped)
((before > 300)) || fail "$before scans saved while the server was away"
start_server
await said 2 "works again"
wait "$player" || fail "lcm-logplayer: $(cat player.log)"
await splinemap watch --once --timeout 2
expect 0 splinemap query --live 0 0
expect 0 splinemap watch --once --json
[[ $(jq '.problems.bus_away' out) -ge 2 ]] || fail "bus_away is not counted: $(cat out)"
# Ended without a server, it saves as well.
end_server
end_daemon
((before + 300 < $(mapped))) || fail "$before scans, and only $(mapped) in the end"
[[ $(grep -o 'mapped [0-9]*' daemon.log) == "mapped $(mapped)" ]] ||
  fail "not all are saved: $(mapped), $(cat daemon.log)"
echo "server: $before scans saved when it went, $(mapped) in the end"

# Multicast: only in a network namespace of our own.
export LCM_DEFAULT_URL=$multicast
if ! ip route del 224.0.0.0/4 dev lo 2> /dev/null; then
  echo "bus_away: multicast skipped, no network namespace can be made here"
  exit 0
fi
# A daemon before there is a network, as when a computer starts.
rm -f live.splinemap
expect 1 splinemap query 0 0 --live --timeout 0.5
expect_text "is there a multicast route?" err
splinemapd --config mapping.textproto 2> daemon.log &
daemon=$!
await said 1 "is there a multicast route?"
ip link add robot type veth peer name elsewhere
ip link set robot up
ip link set elsewhere up
ip address add 10.9.9.1/24 dev robot
ip route add 224.0.0.0/4 dev robot
await said 1 "works again"
# An interface that goes down, and one that is pulled out, and comes back as another.
count=0
for breaks in "ip link set robot down" "ip link del robot"; do
  lcm-logplayer -s 25 office.lcmlog > player.log 2>&1 || fail "lcm-logplayer: $(cat player.log)"
  await bash -c "splinemap watch --once --json --timeout 2 > status.json && ((\$(jq .scans_mapped status.json) > $count + 300))"
  splinemap watch --timeout 30 > watched 2> watch.log &
  watch=$!
  sleep 1.5
  $breaks
  await grep -q "is there a multicast route?" watch.log
  sleep 1
  count=$(mapped)
  ip link show robot > /dev/null 2>&1 || ip link add robot type veth peer name elsewhere
  ip link set robot up
  ip link set elsewhere up
  ip address add 10.9.9.1/24 dev robot 2> /dev/null || true
  ip route add 224.0.0.0/4 dev robot
  await splinemap watch --once --timeout 2
  await grep -q "works again" watch.log
  : > watched
  await grep -q "^robot: " watched  # who only listens hears again, too
  kill "$watch"
  wait "$watch" || true
done
lcm-logplayer -s 25 office.lcmlog > player.log 2>&1
await bash -c "splinemap watch --once --json --timeout 2 > status.json && ((\$(jq .scans_mapped status.json) > $count + 300))"
end_daemon
echo "multicast: $count scans saved when it went, $(mapped) in the end"

# A firewall through which nothing comes back.
if nft add table ip t && nft "add chain ip t i { type filter hook input priority 0; }" &&
  nft add rule ip t i udp dport 7667 drop; then
  expect 1 timeout 60 splinemap watch --timeout 0.5
  expect_text "does a firewall keep it away?" err
fi
