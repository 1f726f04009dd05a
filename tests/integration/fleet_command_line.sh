#!/usr/bin/env bash
# splinemap --fleet on a real nats-server: whatever a command says of a fleet's map is what it says
# of the map file that the robots' layers come from; people change layers; and errors can be read.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

PATH=$PATH:/usr/sbin
if ! command -v nats-server > /dev/null; then
  echo "fleet_command_line: skipped, nats-server is not installed"
  exit 0
fi
hub=nats://127.0.0.1:4510

# start_server FLAGS..; end_server ends the last.
start_server() {
  rm -f server.log
  nats-server -a 127.0.0.1 -p 4510 -js -sd store "$@" > server.log 2>&1 &
  server=$!
  await grep -q "Server is ready" server.log
}
end_server() {
  kill "$server"
  wait "$server" || true
}

# Two robots that drive through one office, in frames of their own, and one that goes with both.
splinemap simulate office.lcmlog 2> /dev/null
robot() {
  local name=$1
  shift
  splinemap build office.lcmlog "$name.whole" --name "$name" "${@:3}"
  splinemap fold "$name.whole" "${@:1:2}" --out "$name.splinemap"
}
robot robot-1 --until start+80s 2> robot-1.log &
robots=$!
robot robot-2 --from end-80s --frame 12,-5,130 2> robot-2.log || fail "robot-2: $(cat robot-2.log)"
wait $robots || fail "robot-1: $(cat robot-1.log)"
splinemap build office.lcmlog robot-3.splinemap --name robot-3 2> robot-3.log &
robots=$!
expect 0 splinemap merge robot-1.splinemap robot-2.splinemap -o both.splinemap

# --- who may not write; that takes some seconds, and is looked at at the end
cat > readers.conf << 'END'
no_auth_user: reader
authorization { users: [{ user: reader, password: reader, permissions: { publish: { deny: "$KV.>" } } }] }
END
readers=nats://127.0.0.1:4512
start_server -p 4512 -sd readers
fleet_put robot-1.splinemap $readers map
end_server
start_server -p 4512 -sd readers -c readers.conf
expect 0 splinemap snapshot --fleet $readers readers.splinemap
splinemap layer remove --fleet $readers robot-1 2> denied &
removing=$!

# --- what is not there is said at once
expect 1 splinemap --fleet $hub query 1 2
expect_text "no NATS server answers at $hub; is nats-server running there?" err
start_server
expect 1 splinemap --fleet $hub query 1 2
expect_text "the servers have no map 'map': splinemap-fleet-worker makes it" err
for command in "layers" "render" "snapshot x.splinemap" "merge -o x.splinemap" "watch --once" \
  "layer mute robot-1"; do
  read -ra words <<< "$command"
  expect 1 splinemap "${words[@]}" --fleet $hub --fleet-map none
  expect_text "the servers have no map 'none'" err
done

fleet_put robot-1.splinemap $hub map
fleet_put robot-2.splinemap $hub map
expect 1 splinemap --fleet $hub query 1 2 --timeout 0.3
expect_text "no splinemap-fleet-worker answers for the map 'map'" err
splinemap-fleet-worker --fleet $hub 2> worker.log &

# --- flags that are not right; meanwhile the worker begins
expect 2 splinemap --fleet $hub
expect_text "give a command" err
expect 2 splinemap --fleet
expect_text "give a command" err
expect 2 splinemap --fleet $hub info both.splinemap
expect_text "splinemap info: there is no flag --fleet" err
expect_text "it does not work on a fleet, splinemap snapshot --fleet makes a map file of one" err
expect 2 splinemap query --fleet $hub --live 1 2
expect_text "--live excludes --fleet" err
expect 2 splinemap query --fleet $hub both.splinemap 1 2
expect_text "both.splinemap is not a number; --fleet takes the place of the map file" err
expect 2 splinemap layers --fleet $hub both.splinemap
expect_text "both.splinemap is one argument too many" err
expect 2 splinemap render --fleet $hub both.splinemap x.png
expect_text "give one output after --fleet, which takes the place of the map file" err
expect 2 splinemap query both.splinemap 1 2 --credentials folder
expect_text "--credentials requires --fleet" err
expect 2 splinemap query both.splinemap 1 2 --timeout 3
expect_text "--timeout requires --live or --fleet" err
expect 2 splinemap query --fleet $hub 1 2 --robot robot-1
expect_text "--robot requires --live" err
expect 2 splinemap watch --fleet $hub --lcm-url memq://
expect_text "excludes" err
expect 2 splinemap query --fleet http://hub 1 2
expect_text "is no NATS server" err
expect 2 splinemap query --fleet '' 1 2
expect_text "is no NATS server" err
expect 2 splinemap query --fleet $hub --fleet-map a.b 1 2
expect_text "letters, digits, _ and -" err
expect 1 splinemap query --fleet $hub --credentials none 1 2
expect_text "none/ca.pem is not there" err

# --- wherever the flags stand, and in whatever form
await splinemap --fleet $hub query 1 2
expect 0 splinemap --fleet $hub query 3 2
cp out once
expect 0 splinemap query --fleet $hub 3 2
cmp out once || fail "the flag before the command and behind it"
expect 0 splinemap --fleet=$hub --fleet-map map query 3 2
cmp out once || fail "the flag with ="
expect 0 splinemap --fleet $hub query -- 3 2
cmp out once || fail "the flag before --"

# --- the same as of the file
same() {
  local command=$1
  shift
  expect 0 splinemap "$command" both.splinemap "$@"
  cp out of_file
  expect 0 splinemap "$command" --fleet $hub "$@"
  cmp out of_file || fail "$command of the fleet differs: $(diff out of_file)"
}
for ((k = 0; k < 200; ++k)); do echo "$((k % 20)).$k,$((k / 10 - 8)).3"; done > points.csv
same query --points points.csv --hessian
[[ $(awk -F, '$7 == 1' out | wc -l) -gt 50 ]] || fail "points beside the map: $(cat out)"
same query 3 2 --json
same ray 3 2 90 --max-range 5 --unknown free
same distance 3 2
same check 3 2 3.1 2 --radius 0.05 --unknown free
for out in part.csv part.png; do
  expect 0 splinemap raster both.splinemap "of_file_$out" --region -1,-1,4,3
  expect 0 splinemap raster --fleet $hub "$out" --region -1,-1,4,3
  cmp "$out" "of_file_$out" || fail "raster $out"
done
expect 0 splinemap render both.splinemap of_file.png
expect 0 splinemap render --fleet $hub of_fleet.png
cmp of_fleet.png of_file.png || fail "render"
expect 0 splinemap render --fleet $hub
expect_text "###" out
expect 0 splinemap export both.splinemap of_file --format geotiff
expect 0 splinemap export --fleet $hub of_fleet --format geotiff
cmp of_fleet.tif of_file.tif || fail "export"
expect 0 splinemap render robot-2.splinemap of_file.png --force
expect 0 splinemap render --fleet $hub --robot 'robot-2*' of_fleet.png --force
cmp of_fleet.png of_file.png || fail "one robot of the fleet"
expect 1 splinemap render --fleet $hub --robot robot-9
expect_text "has no layer of robot-9; splinemap layers lists them" err

# --- layers, watch
expect 0 splinemap layers --fleet $hub
[[ $(head -n 1 out) == layer*state*session*commits*hash*settings && $(grep -c " whole " out) == 2 ]] ||
  fail "layers: $(cat out)"
content='[.[] | [.name, .origin, .session_number, .commits, .tiles, .area_m2, .contradicted, .hash, .in_sum]]'
expect 0 splinemap layers --fleet $hub --json
[[ $(jq -c "$content" out) == "$(splinemap layers both.splinemap --json | jq -c "$content")" &&
  $(jq -c 'map(.state)' out) == '["whole","whole"]' ]] || fail "layers: $(cat out)"
expect 0 splinemap watch --fleet $hub --once
[[ $(wc -l < out) == 1 ]] || fail "watch: $(cat out)"
expect_text "map: 2 layers, 2 of them whole; " out
expect 0 splinemap watch --fleet $hub --once --json
[[ $(jq -c '[.map, .problem, .refused, (.layers[] | [.name, .is_whole]), .bytes_received > 1000]' out) == \
  '["map","",[],["robot-1",true],["robot-2",true],true]' ]] || fail "watch: $(cat out)"
timeout 10 script -qfc "splinemap watch --fleet $hub" screen > /dev/null 2>&1 < /dev/null &
drawing=$!
await grep -q "2 of them whole" screen
kill $drawing  # which takes it two seconds
grep -q "robot-2@[0-9a-f]* .* whole" screen || fail "watch in a terminal: $(cat screen)"

# --- snapshot and merge make the files again
expect 0 splinemap snapshot --fleet $hub copy.splinemap
expect 0 splinemap diff copy.splinemap both.splinemap
hashes() { splinemap layers "$1" --json | jq -c '.[] | [.name, .origin, .session_nonce, .commits, .hash]'; }
cmp <(hashes copy.splinemap) <(hashes both.splinemap) || fail "the copy differs"
expect 2 splinemap snapshot --fleet $hub copy.splinemap
expect_text "copy.splinemap exists; --force replaces it" err
expect 0 splinemap snapshot --fleet $hub --robot robot-1 one.splinemap
expect 0 splinemap diff one.splinemap robot-1.splinemap
expect 1 splinemap snapshot --fleet $hub --region 900,900,901,901 none.splinemap
expect_text "has no layer in --region 900,900,901,901, so nothing is written" err
expect 1 splinemap snapshot --fleet $hub --robot robot-9 none.splinemap
[[ ! -e none.splinemap ]] || fail "a snapshot of nothing"
expect 2 splinemap snapshot --fleet $hub --level 1 none.splinemap
expect 0 splinemap layer remove robot-1.splinemap robot-1 -o empty.splinemap
fleet_put empty.splinemap $hub empty
expect 1 splinemap snapshot --fleet $hub --fleet-map empty none.splinemap
expect_text "the fleet's map 'empty' has no layer, so nothing is written" err
expect 0 splinemap merge --fleet $hub -o copy.splinemap --force
expect_text "merged 1 maps: 2 layers" err
expect 0 splinemap diff copy.splinemap both.splinemap
cmp <(hashes copy.splinemap) <(hashes both.splinemap) || fail "merged, the copy differs"
wait $robots || fail "robot-3: $(cat robot-3.log)"
expect 0 splinemap merge both.splinemap robot-3.splinemap -o three.splinemap
expect 0 splinemap merge --fleet $hub robot-3.splinemap robot-1.splinemap -o copy.splinemap --force
expect 0 splinemap diff copy.splinemap three.splinemap
expect 2 splinemap merge -o x.splinemap
expect_text "give the map files to merge, or --fleet, or both" err

# --- people place, mute and remove layers
was() { sed -nE 's/^place [^ ]+ [^;]*; it was at (.*)$/\1/p' err; }
setting() { splinemap layers --fleet $hub --json | jq -c "map(select(.name == \"$1\"))[0] | $2"; }
splinemap align both.splinemap robot-2 robot-1 --json > of_file &
aligning=$!
expect 0 splinemap align --fleet $hub robot-2 robot-1 --json
cp out of_fleet
wait $aligning || fail "align of the file"
cmp of_file of_fleet || fail "align: $(diff of_file of_fleet)"
expect 0 splinemap align --fleet $hub robot-2 robot-1 --apply
[[ $(was) == "0 0 0" ]] || fail "it was: $(cat err)"
[[ $(setting robot-1 '(.placement.x_m - 12 | fabs) < 0.02 and .placement.yaw_deg > 129') == true ]] ||
  fail "placed: $(splinemap layers --fleet $hub)"
expect 0 splinemap align --fleet $hub robot-2 robot-1 --json
[[ $(jq '[.x_m, .y_m, .yaw_deg] | all(fabs < 0.1)' out) == true ]] || fail "placed, and found: $(cat out)"
expect 0 splinemap layer place --fleet $hub robot-1 0 0 0
expect 2 splinemap align --fleet $hub robot-2 nobody
expect_text "the fleet's map has no layer nobody" err
expect 2 splinemap align --fleet $hub robot-2
expect_text "give two map files, or two layers" err
expect 2 splinemap align --fleet $hub robot-2 robot-1 --apply --out x.splinemap
expect 0 splinemap --fleet $hub layer mute robot-2
expect_text "mute robot-2@" err
[[ $(setting robot-2 .muted) == true ]] || fail "muted: $(splinemap layers --fleet $hub)"
expect 0 splinemap layer mute both.splinemap robot-2 -o muted.splinemap
same_sum() {
  expect 0 splinemap query "$1" --points points.csv
  cp out of_file
  for _ in {1..50}; do  # workers hear of it
    expect 0 splinemap query --fleet $hub --points points.csv
    cmp -s out of_file && return
    sleep 0.1
  done
  fail "$1 and the fleet's map differ: $(diff out of_file)"
}
same_sum muted.splinemap
cp out without_robot_2
expect 0 splinemap layer unmute --fleet $hub robot-2 robot-1
same_sum both.splinemap
! cmp -s out without_robot_2 || fail "robot-2 does not matter"
expect 0 splinemap layer low-weight --fleet $hub robot-2
[[ $(setting robot-2 .low_weight) == true ]] || fail "low weight: $(splinemap layers --fleet $hub)"
expect 0 splinemap layer normal-weight --fleet $hub robot-2
# Of two at once both count.
changing=()
for setting in mute low-weight mute low-weight mute low-weight mute low-weight; do
  splinemap layer $setting --fleet $hub robot-1 2> /dev/null &
  changing+=($!)
done
for job in "${changing[@]}"; do wait "$job" || fail "a setting among others"; done
[[ $(setting robot-1 '.muted and .low_weight') == true ]] || fail "at once: $(splinemap layers --fleet $hub)"
expect 2 splinemap layer mute --fleet $hub nobody
expect_text "the fleet's map has no layer nobody" err
expect 0 splinemap layer remove --fleet $hub robot-1
expect 0 splinemap layers --fleet $hub
[[ $(grep "robot-1@" out) == *" removed "*"removed" ]] || fail "removed: $(cat out)"
same_sum robot-2.splinemap
expect 0 splinemap merge --fleet $hub robot-1.splinemap -o copy.splinemap --force
expect_text "is left out: removed" err

# --- a layer that is not whole is named, and nothing of it is taken for the whole
expect 0 fleet_put both.splinemap $hub torn torn
asking=()
for command in "snapshot torn.splinemap" "merge -o torn.splinemap" \
  "align robot-2 robot-1"; do
  read -ra words <<< "$command"
  (
    work=$work/${words[0]}
    mkdir "$work"
    expect 1 splinemap "${words[@]}" --fleet $hub --fleet-map torn --timeout 0.5
    expect_text "the fleet's map 'torn' did not become whole, and nothing new came for 0.5 s; robot-" err
    expect_text "tiles so far; --timeout gives it more time" err
  ) &
  asking+=($!)
done
for job in "${asking[@]}"; do wait "$job" || fail "what is not whole"; done
[[ ! -e torn.splinemap ]] || fail "a snapshot of a part"
expect 1 splinemap layers --fleet $hub --fleet-map torn --timeout 0.5 --json
[[ $(jq -c 'map(.state) | sort' out) == '["stale","whole"]' ]] || fail "torn: $(cat out)"
whole=$(jq -r 'map(select(.state == "whole"))[0].name' out)
expect 0 splinemap watch --fleet $hub --fleet-map torn --once
expect_text "torn: 2 layers, 1 of them whole; " out
# The other one is there.
expect 0 splinemap snapshot --fleet $hub --fleet-map torn --robot "$whole" torn.splinemap
expect 0 splinemap diff torn.splinemap "$whole.splinemap"
# Its robot writes it again.
fleet_put both.splinemap $hub torn
expect 0 splinemap snapshot --fleet $hub --fleet-map torn torn.splinemap --force
expect 0 splinemap diff torn.splinemap both.splinemap

# --- a watch hears of what changes, and of servers that go away
splinemap watch --fleet $hub --fleet-map torn --timeout 1 > watch.log 2> watch.err &
watching=$!
await grep -q "2 layers, 2 of them whole" watch.log
fleet_put robot-3.splinemap $hub torn
await grep -q "3 layers, 3 of them whole" watch.log
end_server
# What follows asks another server.
lost=$hub
hub=nats://127.0.0.1:4511
start_server -p 4511

# --- the viewer shows it, and follows
if command -v splinemap-viewer > /dev/null; then
  expect 2 splinemap-viewer --fleet $hub both.splinemap
  expect 2 splinemap-viewer --fleet $hub --lcm-url memq://
  expect 2 splinemap-viewer --fleet $hub --allow-commands
  expect_text "the map of a file or a fleet is shown alone" err
  expect 1 splinemap-viewer --fleet nats://127.0.0.1:4519
  expect_text "no NATS server answers at nats://127.0.0.1:4519" err
  fleet_put robot-1.splinemap $hub viewed
  splinemap-viewer --fleet $hub --fleet-map viewed --port 0 2> viewer.log &
  viewer=$!
  await grep -q "The map is at http" viewer.log
  port=$(sed -nE 's#^The map is at http://[^:]+:([0-9]+)/.*#\1#p' viewer.log)
  cat > page.py << 'END'
import subprocess, sys
from web_client import WebSocket

port, hub, more = int(sys.argv[1]), sys.argv[2], sys.argv[3]
with WebSocket(port) as page:
    def until(section, is_so):
        while True:
            told = page.frame().get(section)
            if told is not None and is_so(told):
                return told
    whole = lambda count: lambda layers: len(layers) == count and all(layer["caught_up"] for layer in layers)
    until("layers", whole(1))
    subprocess.run(["fleet_put", more, hub, "viewed"], check=True)
    layers = until("layers", whole(2))
    assert sorted(layer["name"] for layer in layers) == ["robot-1", "robot-3"], layers
    subprocess.run(["splinemap", "layer", "mute", "robot-1", "--fleet", hub, "--fleet-map", "viewed"], check=True)
    until("layers", lambda layers: any(layer["is_muted"] for layer in layers))
with WebSocket(port) as page:
    told = page.frame()["map"]
    assert (told["source"], told["name"]) == ("fleet", "viewed of " + hub), told
    assert told["is_caught_up"] and not told["problem"] and not told["allows_commands"], told
END
  PYTHONPATH=$top/tests/support timeout 60 python3 page.py "$port" $hub robot-3.splinemap 2> page.err ||
    fail "the page: $(cat page.err viewer.log)"
  expect 0 curl -sS "localhost:$port/api/query?x=3&y=2"
  [[ $(jq '.log_odds * 1000 | round' out) == "$(splinemap query robot-3.splinemap 3 2 --json |
    jq '.log_odds * 1000 | round')" ]] || fail "the viewer's answer: $(cat out)"
  expect 0 curl -sS -H 'Content-Type: application/json' -d '{}' "localhost:$port/api/mute"
  expect_text "the map of a fleet takes no commands" out
  kill "$viewer"
fi

# --- with scans, where robots have brought their map files; of these, their own layer alone counts
expect 0 splinemap fold robot-1.splinemap --out later.splinemap
expect 0 splinemap layer mute both.splinemap robot-1 -o brought.splinemap
for map in later robot-2 robot-3; do fleet_put $map.splinemap $hub kept; done
expect 1 splinemap snapshot --fleet $hub --fleet-map kept --scans none.splinemap
expect_text "the servers have no map 'kept_files'" err
fleet_put robot-2.splinemap $hub kept damaged
fleet_put brought.splinemap $hub kept file
expect 1 splinemap snapshot --fleet $hub --fleet-map kept --scans kept.splinemap
[[ $(grep "scans" err) =~ ^"robot-1: 801 scans, copied "[0-9]" s ago, 1 commits behind the fleet's tiles, of \
an earlier session"$'\n'"robot-2: no scans, a part of the map file of robot-2 is damaged or gone; \
the robot brings it again"$'\n'"robot-3: no scans, its robot brings no map file" ]] || fail "scans: $(cat err)"
expect 0 splinemap diff kept.splinemap three.splinemap
cmp <(hashes kept.splinemap) <(hashes three.splinemap) || fail "with scans, the copy differs"
[[ $(splinemap info kept.splinemap --json | jq -c '[.layers[].scans]') == "[801,0,0]" ]] ||
  fail "scans of the copy: $(splinemap info kept.splinemap)"
[[ -z $(find . -name '*.part*') ]] || fail "left behind: $(find . -name '*.part*')"
expect 0 splinemap layers --fleet $hub --fleet-map kept
[[ $(head -n 1 out) == *file_s* ]] || fail "layers: $(cat out)"
expect 0 splinemap layers --fleet $hub --fleet-map kept --json
[[ $(jq -c 'map(.file_age_s | . != null and . >= 0 and . < 60)' out) == "[true,true,false]" ]] ||
  fail "files: $(cat out)"
fleet_put robot-2.splinemap $hub kept file
expect 0 splinemap snapshot --fleet $hub --fleet-map kept --scans --robot robot-1 --robot robot-2 \
  all.splinemap
# A file that is no map, and one of another layer.
cp office.lcmlog junk.splinemap
fleet_put robot-2.splinemap $hub kept file junk.splinemap
fleet_put robot-1.splinemap $hub kept file robot-2.splinemap
expect 1 splinemap snapshot --fleet $hub --fleet-map kept --scans kept.splinemap --force
expect_text "robot-1: no scans, its map file does not have this layer" err
expect_text "robot-2: no scans, its map file is damaged" err
expect 0 splinemap diff kept.splinemap three.splinemap
# One without scans.
expect 0 splinemap snapshot --fleet $hub --fleet-map kept --robot robot-1 bare.splinemap
fleet_put robot-1.splinemap $hub kept file bare.splinemap
expect 1 splinemap snapshot --fleet $hub --fleet-map kept --scans --robot robot-1 one.splinemap --force
expect_text "robot-1: no scans, its map file keeps none" err

# --- what copies of map files are for
contents() { splinemap layers "$1" --json | jq -c 'map([.name, .hash])'; }
as_of_files() {
  expect 0 splinemap "${@:1:1}" all.splinemap "${@:2}" --out of_copies.splinemap --force
  expect 0 splinemap "${@:1:1}" both.splinemap "${@:2}" --out of_files.splinemap --force
  [[ $(contents of_copies.splinemap) == "$(contents of_files.splinemap)" ]] || fail "of copies: $*"
}
expect 0 splinemap fold all.splinemap --out of_copies.splinemap
[[ $(contents of_copies.splinemap) == "$(contents both.splinemap)" ]] || fail "a fold of copies"
as_of_files forget --before end-1m
[[ $(contents of_copies.splinemap) != "$(contents both.splinemap)" ]] || fail "nothing was forgotten"
splinemap trajectory all.splinemap --layer robot-1 | awk -F, 'NR > 1 { $2 += 0.5 } 1' OFS=, > moved.csv
as_of_files correct moved.csv --layer robot-1
expect 1 splinemap fold kept.splinemap --out none.splinemap
expect_text "layer robot-1: the map keeps no scans of it" err

status=0
wait "$watching" || status=$?
((status == 1)) || fail "watch ended with $status: $(cat watch.err)"
grep -q "the connection to the NATS servers at $lost is lost" watch.err || fail "$(cat watch.err)"
[[ ! -e viewer.log ]] || wait "$viewer" || fail "splinemap-viewer: $(cat viewer.log)"
end_server

# --- who may not write is told
status=0
wait "$removing" || status=$?
((status == 1)) || fail "removed without permission: $(cat denied)"
grep -q "the servers do not allow it" denied || fail "$(cat denied)"
grep -q "are these the right credentials?" denied || fail "$(cat denied)"
expect 0 splinemap layers --fleet $readers
[[ $(grep -c " whole " out) == 1 ]] || fail "changed all the same: $(cat out)"

echo "fleet_command_line: the fleet's map says what the files say, layers are changed, errors can be read"
