#!/usr/bin/env bash
# Maps of several robots as files: merged in any order and grouping, without one of them, flattened;
# and what is refused. Drives are the recorded ones, their scans shared among robots.
# `merging.sh TOP all` shares every drive among 2, 5 and 20 robots; without, some of them once.
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

# hashes MAP: what the file has, but for what may differ: its times.
hashes() {
  splinemap layers "$1" --json |
    jq -c '.[] | [.name, .origin, .session_number, .session_nonce, .commits, .hash, .muted, .removed_up_to]'
}

# same A B: equal for diff, and every layer has one identity, state and hash in both.
same() {
  expect 0 splinemap diff "$1" "$2"
  cmp <(hashes "$1") <(hashes "$2") || fail "$1 and $2 differ"
}

merge() {
  expect 0 splinemap merge "$@" --force
  [[ $(tail -n 1 err) == "merged "* ]] || fail "said: $(cat err)"
}

# Without scans layers are placed where they are read; archive.sh places others.
printf 'service { max_archive_mb: 0 }\n' > without_scans.textproto

# robots LOG COUNT FLAGS..: map_1.splinemap .. map_COUNT.splinemap, a robot each.
robots() {
  local log=$1 count=$2 scan k
  shift 2
  scan=$1
  "$top/tests/support/split_drive.py" "$log" "$scan" "$count" part_
  rm -f map_*.splinemap
  for ((k = 1; k <= count; ++k)); do
    expect 0 splinemap build "part_$k.lcmlog" "map_$k.splinemap" --name "robot-$k" \
      --scan "$scan" --pose "$2" --config without_scans.textproto
  done
  rm part_*.lcmlog
}

# orders COUNT: of the maps that robots made.
orders() {
  local count=$1 backwards k
  maps=(); backwards=()
  for ((k = 1; k <= count; ++k)); do
    maps+=("map_$k.splinemap")
    backwards=("map_$k.splinemap" "${backwards[@]}")
  done
  merge "${maps[@]}" -o all.splinemap
  [[ $(splinemap layers all.splinemap --json | jq length) == "$count" ]] || fail "layers: $(hashes all.splinemap)"
  merge "${backwards[@]}" "${maps[0]}" -o other.splinemap
  same all.splinemap other.splinemap
  # Halves that overlap, one within the other, and all of it once more.
  merge "${maps[@]:0:count / 2 + 1}" -o half.splinemap
  merge "${maps[@]:count / 2}" half.splinemap -o other.splinemap
  merge other.splinemap half.splinemap "${maps[@]: -1}" -o again.splinemap
  same all.splinemap again.splinemap
}

# without_one: of the maps that orders merged, and then with it as an older file has it.
without_one() {
  expect 0 splinemap layer remove all.splinemap robot-1 -o without.splinemap --force
  merge "${maps[@]:1}" -o other.splinemap
  expect 0 splinemap diff without.splinemap other.splinemap
  expect_text "layer robot-1@" out
  expect_text ": removed, only in without.splinemap" out
  merge all.splinemap without.splinemap -o again.splinemap
  expect_text "robot-1@" err
  expect_text "is left out: removed" err
  same without.splinemap again.splinemap
}

# flatten MAP: in one layer the map is the same.
flatten() {
  expect 0 splinemap flatten "$1" flat.splinemap --name lab --force
  cp err said
  [[ $(splinemap layers flat.splinemap --json | jq -c 'map([.name, .muted, .placement.x_m])') == '[["lab",false,0]]' ]] ||
    fail "flat: $(hashes flat.splinemap)"
  local map
  for map in "$1" flat.splinemap; do
    splinemap export "$map" "$map" --format geotiff --force 2> /dev/null
  done
  cmp "$1.tif" flat.splinemap.tif || fail "the flat map is another"
  mv said err
}

splinemap simulate office.lcmlog 2> /dev/null
robots office.lcmlog 5 LASER POSE
orders 5
without_one
cp all.splinemap fleet.splinemap
mkdir maps
cp map_*.splinemap maps
flatten fleet.splinemap

# --- the layers of a map
expect 0 splinemap layers fleet.splinemap
[[ $(wc -l < out) == 6 && $(head -n 1 out) == layer*session*commits*tiles*area_m2*contradicted*box_m*hash*settings ]] ||
  fail "layers: $(cat out)"
expect 0 splinemap layers fleet.splinemap --json
[[ $(jq '.[2] | .name == "robot-3" and .session_number == 1 and .commits > 200 and .in_sum and
         .area_m2 > 1 and .box_m[0] < .box_m[2] and .box_m[1] < .box_m[3]' out) == true ]] || fail "$(cat out)"
[[ $(jq '[.[] | [.area_m2, .tiles, .commits]]' out) == "$(splinemap info fleet.splinemap --json |
  jq '[.layers[] | [.area_m2, .tiles, .commits]]')" ]] || fail "layers and info differ: $(cat out)"
# The box of robot-2 in mm.
box() { splinemap layers "$1" --json | jq -c '.[1].box_m | map(. * 1000 | round)'; }
origin() { splinemap layers "$1" --json | jq -r "map(select(.name == \"$2\"))[0].origin"; }

# --- a layer in another frame
expect 0 splinemap merge maps/*.splinemap -o same_frame.splinemap
if grep -q "saw free space" err; then fail "one frame: $(cat err)"; fi
[[ $(splinemap layers same_frame.splinemap --json | jq '[.[].contradicted] | max < 0.1') == true ]] ||
  fail "one frame: $(splinemap layers same_frame.splinemap)"
expect 0 splinemap layer place maps/map_2.splinemap robot-2 1 0.5 0 -o moved.splinemap
expect 0 splinemap merge moved.splinemap maps/map_[1345].splinemap -o frames.splinemap
expect_text "obstacles of robot-2@" err
expect_text "are where the others saw free space; its frame may be another" err
[[ $(splinemap layers frames.splinemap --json | jq -r 'max_by(.contradicted).name') == robot-2 ]] ||
  fail "another frame: $(splinemap layers frames.splinemap)"
expect 2 splinemap render frames.splinemap --contradictions
expect 0 splinemap render frames.splinemap frames.png --contradictions
expect_text "are obstacles of one layer where the others saw free space" err
rm moved.splinemap frames.splinemap frames.png same_frame.splinemap

# --- which layer to remove
expect 2 splinemap layer remove fleet.splinemap robot -o x.splinemap
expect_text "fleet.splinemap has no layer robot (did you mean robot-1?); the layers are: robot-1@" err
expect 2 splinemap layer remove fleet.splinemap robot-1@xyz -o x.splinemap
expect 0 splinemap layer remove fleet.splinemap "robot-2@$(origin fleet.splinemap robot-2)" robot-4 -o x.splinemap
merge maps/map_[135].splinemap -o other.splinemap
expect 0 splinemap diff x.splinemap other.splinemap
expect 0 splinemap layer remove x.splinemap robot-1 robot-3 robot-5 -o none.splinemap
expect 0 splinemap info none.splinemap --json
[[ $(jq -c '[.tiles, .layers]' out) == '[0,[]]' ]] || fail "all removed: $(cat out)"
[[ $(splinemap layers none.splinemap | grep -c "removed$") == 5 ]] || fail "$(splinemap layers none.splinemap)"
rm x.splinemap

# --- two layers of one name
expect 0 splinemap build office.lcmlog namesake.splinemap --name robot-1
merge namesake.splinemap fleet.splinemap -o names.splinemap
expect_text "stay apart; they come from two robots of one name" err
[[ $(splinemap layers names.splinemap --json | jq length) == 6 ]] || fail "layers of one name are one"
expect 2 splinemap layer remove names.splinemap robot-1 -o x.splinemap
expect_text "names.splinemap has several layers robot-1; give one of: robot-1@" err
id=$(origin namesake.splinemap robot-1)
expect 0 splinemap layer remove names.splinemap "robot-1@${id:0:9}" -o x.splinemap
expect 0 splinemap diff x.splinemap fleet.splinemap
rm x.splinemap

# --- settings, in a copy of the map
# change COMMAND LAYER [X_M Y_M YAW_DEG] -- FROM TO
change() {
  local command=$1 words=()
  shift
  while [[ $1 != -- ]]; do words+=("$1"); shift; done
  expect 0 splinemap layer "$command" "$2" "${words[@]}" --out "$3" --force
}
cp fleet.splinemap before.splinemap
for setting in "mute robot-2" "place robot-2 0.35 -2 0" "place robot-2 1.01 0 -30.25" "low-weight robot-2"; do
  read -ra words <<< "$setting"
  change "${words[@]}" -- fleet.splinemap changed.splinemap
  expect_text "${words[0]} robot-2@" err
  cmp fleet.splinemap before.splinemap || fail "the input of ${words[0]} has changed"
  expect 1 splinemap diff changed.splinemap fleet.splinemap
  expect_text "layer robot-2: " out
  expect_text "in changed.splinemap, no settings in fleet.splinemap" out
  expect 0 splinemap layers changed.splinemap
  [[ $(grep -cE "robot-2.* (muted|placed at 0.35, -2 m, 0 deg|placed at 1.01, 0 m, -30.25 deg, approximate|low weight)$" out) == 1 ]] || fail "layers: $(cat out)"
  [[ $setting != *" 0" || $(box changed.splinemap) == "$(box fleet.splinemap |
    jq -c '[.[0] + 350, .[1] - 2000, .[2] + 350, .[3] - 2000]')" ]] || fail "box: $(cat out)"
  if [[ $setting != low-weight* ]]; then
    expect 1 splinemap diff changed.splinemap fleet.splinemap
    expect_text "the sum of all layers: " out
  fi
  # It stays, whatever is merged with it, and a flat map is the sum that it says.
  merge maps/map_2.splinemap changed.splinemap fleet.splinemap -o other.splinemap
  same changed.splinemap other.splinemap
  flatten changed.splinemap
  [[ $setting != mute* ]] || expect_text "is left out: muted" err
  case ${words[0]} in
    mute) change unmute robot-2 -- changed.splinemap back.splinemap ;;
    place) change place robot-2 0 0 0 -- changed.splinemap back.splinemap ;;
    low-weight) change normal-weight robot-2 -- changed.splinemap back.splinemap ;;
  esac
  expect 0 splinemap diff back.splinemap fleet.splinemap
done
for bad in "mute" "mute robot" "place robot-2" "place robot-2 7" "place robot-2 7 0.5" \
  "place 7 0.5 0" "place robot-2 1e300 0 0" "place robot-2 0 nan 0" "place robot-2 0 0 inf" \
  "place robot-2 0 -33554433 0"; do
  read -ra words <<< "$bad"
  expect 2 splinemap layer "${words[0]}" fleet.splinemap "${words[@]:1}" --out x.splinemap
done
expect_text "a layer can be placed within 33554 km at most" err
expect 2 splinemap layer place fleet.splinemap robot-2 0 0 left --out x.splinemap
expect_text "left is no number; give the layer, then where its frame lies in the map's: X_M Y_M YAW_DEG" err
# A quarter of a turn is exact, and four of them are none.
expect 0 splinemap layer place fleet.splinemap robot-2 0 0 90 --out turned.splinemap
[[ $(splinemap info turned.splinemap --json | jq -c '[.layers[].is_approximate]') == '[false,false,false,false,false]' ]] ||
  fail "a quarter of a turn: $(splinemap info turned.splinemap)"
expect 0 splinemap layer place turned.splinemap robot-2 0 0 360 --out back.splinemap --force
expect 0 splinemap diff back.splinemap fleet.splinemap
expect 0 splinemap layer place fleet.splinemap robot-2 0 0 1 --out turned.splinemap --force
expect 0 splinemap info turned.splinemap
expect_text "m2 seen, approximate" out
# What is cropped is the map that it was within the region, in its place.
expect 0 splinemap layer place fleet.splinemap robot-2 1.01 2 130 --out turned.splinemap --force
expect 0 splinemap crop turned.splinemap cropped.splinemap --region 0,0,3,2
for map in turned cropped; do
  expect 0 splinemap raster $map.splinemap $map.csv --region 0,0,3,2 --resolution 0.1
done
cmp turned.csv cropped.csv || fail "crop leaves out some of a layer that is placed"
rm turned.* cropped.*
expect 2 splinemap layer mute fleet.splinemap robot-2
expect_text "give the map file to write with --out" err
expect 2 splinemap layer mute fleet.splinemap robot-2 --out changed.splinemap
expect_text "changed.splinemap exists; --force replaces it" err

# --- sessions: a newer one replaces the layer; two of one number come from one copied file
start() {
  splinemapd --map "$1" --name robot-1 --scan LASER --pose POSE --lcm-url memq:// 2> daemon.log &
  local daemon=$!
  started() { [[ $(splinemap layers "$1" --json | jq '.[0].session_number') == 2 ]]; }
  await started "$1"
  kill "$daemon"
  wait "$daemon" || fail "the daemon failed: $(cat daemon.log)"
}
cp maps/map_1.splinemap newer.splinemap
cp maps/map_1.splinemap twin.splinemap
start newer.splinemap
start twin.splinemap
merge fleet.splinemap newer.splinemap -o one.splinemap
expect_text ": session 2 in newer.splinemap replaces session 1 in fleet.splinemap" err
merge newer.splinemap fleet.splinemap -o other.splinemap
same one.splinemap other.splinemap
merge newer.splinemap twin.splinemap -o one.splinemap
expect_text ", since two daemons used one copied file" err
merge twin.splinemap newer.splinemap -o other.splinemap
same one.splinemap other.splinemap

# --- one commit with two contents
cp maps/map_1.splinemap forged.splinemap
forge forged.splinemap robot-1
expect 0 splinemap info forged.splinemap
expect 1 splinemap merge fleet.splinemap forged.splinemap -o one.splinemap --force
expect_text " tiles of forged.splinemap differ from those of fleet.splinemap at the same commit" err
expect 1 splinemap merge forged.splinemap fleet.splinemap -o other.splinemap --force
same one.splinemap other.splinemap
expect 1 splinemap merge one.splinemap fleet.splinemap forged.splinemap -o other.splinemap --force
same one.splinemap other.splinemap

# --- what is refused: nothing is written
printf 'method { knot_interval_m: 0.1 }\n' > coarse.textproto
printf 'method { clamp_max: 20 }\n' > wide.textproto
for kind in coarse wide; do
  expect 0 splinemap build office.lcmlog $kind.splinemap --config $kind.textproto --scan LASER --pose POSE
done
expect 2 splinemap merge fleet.splinemap coarse.splinemap -o x.splinemap
expect_text "knot intervals of coarse.splinemap are 0.1 m, and those of fleet.splinemap are 0.05 m" err
expect 2 splinemap merge fleet.splinemap wide.splinemap -o x.splinemap
expect_text "clamps of wide.splinemap are -64 .. 20 log-odds, and those of fleet.splinemap are -64 .. 64" err
cp fleet.splinemap tile.splinemap
sqlite3 tile.splinemap "UPDATE tile SET content = x'28b52ffd' WHERE rowid = 7"
head -c 40000 fleet.splinemap > cut.splinemap
cp fleet.splinemap newer_schema.splinemap
sqlite3 newer_schema.splinemap "PRAGMA user_version = 99"
sqlite3 foreign.db "CREATE TABLE t (x); INSERT INTO t VALUES (1)"
: > empty.splinemap
for bad in 1:tile.splinemap 1:cut.splinemap 1:newer_schema.splinemap 2:foreign.db 2:office.lcmlog 2:. \
  1:empty.splinemap 1:none_there.splinemap; do
  expect "${bad%%:*}" splinemap merge fleet.splinemap "${bad#*:}" -o x.splinemap
  expect_text "${bad#*:}" err
  expect "${bad%%:*}" splinemap layer remove "${bad#*:}" robot-1 -o x.splinemap
  expect "${bad%%:*}" splinemap flatten "${bad#*:}" x.splinemap
  expect "${bad%%:*}" splinemap layers "${bad#*:}" > /dev/null
done
expect 2 splinemap flatten fleet.splinemap x.splinemap --name no/name
expect 2 splinemap merge fleet.splinemap -o no/such/folder
expect 2 splinemap merge fleet.splinemap
expect 2 splinemap merge -o x.splinemap
[[ -z $(find . -name 'x.*' -o -name '*.part*') ]] || fail "left behind: $(ls)"
# What is left of a damaged file, if that is wanted.
expect 1 splinemap merge tile.splinemap maps/map_2.splinemap -o x.splinemap --accept-corrupt
expect_text "tile.splinemap: layer robot" err
expect 0 splinemap info x.splinemap

# --- outputs that are there, that are read, that are in use
expect 2 splinemap merge fleet.splinemap namesake.splinemap -o other.splinemap
expect_text "other.splinemap exists; --force replaces it" err
ln fleet.splinemap link.splinemap
for out in ./fleet.splinemap link.splinemap; do
  expect 2 splinemap merge namesake.splinemap fleet.splinemap -o $out --force
  expect_text "cannot write $out: the command reads it" err
  expect 2 splinemap layer remove fleet.splinemap robot-1 -o $out --force
  expect 2 splinemap flatten fleet.splinemap $out --force
done
splinemapd --map used.splinemap --scan LASER --pose POSE --lcm-url memq:// 2> daemon.log &
daemon=$!
await splinemap info used.splinemap
expect 1 splinemap merge fleet.splinemap -o used.splinemap --force
expect_text "used.splinemap is in use" err
expect 0 splinemap merge fleet.splinemap used.splinemap -o x.splinemap --force  # which can be read
kill "$daemon"
wait "$daemon" || fail "the daemon failed: $(cat daemon.log)"
# A limit on the size of a file stands in for a full disk: what was there stays.
cp other.splinemap before.splinemap
(
  trap '' XFSZ
  ulimit -f 64
  expect 1 splinemap merge fleet.splinemap namesake.splinemap -o other.splinemap --force
)
cmp other.splinemap before.splinemap || fail "a failed merge changed a file"
[[ -z $(find . -name '*.part*') ]] || fail "left behind: $(ls)"

# --- the recorded drives
if [[ ! -d $shared_data ]]; then
  echo "merging: recorded drives skipped, the shared data folder is not there"
  exit 0
fi
# drive LOG SCAN POSE COUNT..
drive() {
  local log=$1 scan=$2 pose=$3 count
  shift 3
  [[ $choice == all ]] && set -- 2 5 20
  for count in "$@"; do
    robots "$log" "$count" "$scan" "$pose"
    orders "$count"
    [[ $choice$count != 2 ]] || continue  # office and Intel will do
    without_one
  done
  echo "merging: $(basename "$log" .lcmlog) shared among $* robots"
}
choice=${2:-}
drives=(intel csail)
[[ $choice != all ]] || drives+=(aces freiburg-079 belgioioso)
for name in "${drives[@]}"; do
  splinemap import-carmen "$shared_data/carmen/$name-corrected.log.gz" $name.lcmlog 2> /dev/null
done
drive intel.lcmlog LASER POSE 20
for name in "${drives[@]:1}"; do drive $name.lcmlog LASER POSE 2; done
drive "$shared_data/lcm/convex_arena.lcmlog" RPLIDAR_LASER SLAM_POSE 2
drive "$shared_data/lcm/sweep_square.lcmlog" LIDAR SLAM_POSE 2
drive "$shared_data/lcm/odometry_square.lcmlog" LIDAR ODOMETRY 2
