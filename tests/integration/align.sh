#!/usr/bin/env bash
# splinemap align finds how two maps lie to each other, files, layers of a file and of a bus, and
# refuses what cannot be told.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

# near X Y YAW: out is JSON that has this transform, to 2 cm and 0.2 degrees.
near() {
  jq -e --argjson x "$1" --argjson y "$2" --argjson yaw "$3" \
    '[(.x_m - $x) / 0.02, (.y_m - $y) / 0.02, (.yaw_deg - $yaw) / 0.2] | all(fabs < 1)' \
    out > /dev/null || fail "not $1 $2 $3: $(cat out)"
}

# The office, as two robots map it that drive through it in two halves.
expect 0 splinemap simulate office.lcmlog
expect 0 splinemap build office.lcmlog whole.splinemap --name robot-1
expect 0 splinemap fold whole.splinemap --until start+80s --out first.splinemap
expect 0 splinemap build office.lcmlog turned.splinemap --name robot-2 --frame 12,-5,130
expect 0 splinemap fold turned.splinemap --from end-80s --out last.splinemap

expect 0 splinemap align last.splinemap first.splinemap --json
near 12 -5 130
jq -e '.overlap_m2 > 50 and .overlap > 0.5 and .overlap <= 1 and (.agree_m > 10 * .contradict_m) and .residual_m < 0.02 and
  (.covariance | length) == 9 and .covariance[0] > 0 and .covariance[4] > 0 and
  .covariance[8] > 0 and .covariance[1] == .covariance[3] and .score_m > 15 and
  .a == "last.splinemap" and .b == "first.splinemap"' out > /dev/null || fail "figures: $(cat out)"
cp out once
expect 0 splinemap align last.splinemap first.splinemap --json
cmp out once || fail "another answer to the same question"
expect 0 splinemap align last.splinemap first.splinemap --picture both.png
expect_text "from the frame of first.splinemap to that of last.splinemap: x 1" out
expect_text "standard deviations: " out
expect_text "m of walls agree" out
expect_text "both.png: walls of last.splinemap are blue" err
[[ $(head -c 8 both.png | tail -c 7) == $'PNG\r\n\x1a'* ]] || fail "no picture"
expect 2 splinemap align last.splinemap first.splinemap --picture both.png
expect_text "--force" err
expect 0 splinemap align last.splinemap first.splinemap --picture both.png --force
expect 2 splinemap align last.splinemap first.splinemap --picture both.jpg

# Of other knot intervals.
expect 0 splinemap fold first.splinemap --knot-interval-m 0.08 --out coarse.splinemap
expect 0 splinemap align last.splinemap coarse.splinemap --json
near 12 -5 130

# Layers of one file, wherever they are placed; muted ones, too.
expect 0 splinemap merge first.splinemap last.splinemap --out both.splinemap
expect 0 splinemap align both.splinemap robot-2 robot-1 --json
near 12 -5 130
expect 0 splinemap layer mute both.splinemap robot-1 --out muted.splinemap
expect 0 splinemap align muted.splinemap robot-2 robot-1 --json
near 12 -5 130
expect 0 splinemap layer place both.splinemap robot-1 12 -5 130 --out placed.splinemap
expect 0 splinemap align placed.splinemap robot-2 robot-1 --json
near 0 0 0

# --apply places B, exactly, and says where it was.
was() { sed -nE 's/^place [^ ]+ [^;]*; it was at (.*)$/\1/p' err; }
expect 0 splinemap align both.splinemap robot-2 robot-1 --apply --out applied.splinemap
before=$(was)
expect 0 splinemap align applied.splinemap robot-2 robot-1 --json
near 0 0 0
expect 0 splinemap verify applied.splinemap
[[ $(splinemap layers applied.splinemap --json | jq 'map(select(.name == "robot-1")) | .[0] |
  (.placement.x_m - 12 | fabs) < 0.02 and .placement.yaw_deg > 129 and (.is_approximate | not)') == true ]] ||
  fail "layers: $(splinemap layers applied.splinemap)"
# shellcheck disable=SC2086
expect 0 splinemap layer place applied.splinemap robot-1 $before --out before.splinemap
expect 0 splinemap diff both.splinemap before.splinemap
expect 0 splinemap align last.splinemap first.splinemap --apply --out there.splinemap
expect 0 splinemap align last.splinemap there.splinemap --json
near 0 0 0
expect 2 splinemap align both.splinemap robot-2 robot-1 --apply
expect_text "with --out" err
expect 2 splinemap align both.splinemap robot-2 robot-1 --out none.splinemap
expect 2 splinemap align both.splinemap robot-2 robot-1 --picture x.png --apply --out x.png
cp first.splinemap corrupt.splinemap
sqlite3 corrupt.splinemap "UPDATE tile SET content = zeroblob(length(content)) WHERE rowid = (SELECT min(rowid) FROM tile)"
expect 1 splinemap align last.splinemap corrupt.splinemap --apply --out laundered.splinemap
expect_text "nothing is written" err
[[ ! -e laundered.splinemap ]] || fail "a corrupt map was saved as whole"

# What is refused, with figures and without an answer.
cat > room.world << 'END'
wall { x0_m: -4 y0_m: -2 x1_m: 4 y1_m: -2 }
wall { x0_m: 4 y0_m: -2 x1_m: 4 y1_m: 2 }
wall { x0_m: 4 y0_m: 2 x1_m: -4 y1_m: 2 }
wall { x0_m: -4 y0_m: 2 x1_m: -4 y1_m: -2 }
waypoint { x_m: -1 } waypoint { x_m: 1 } waypoint { x_m: 1 y_m: 1 }
END
expect 0 splinemap simulate room.world room.lcmlog
expect 0 splinemap build room.lcmlog room.splinemap
refused() {
  local reason=$1
  shift
  expect 1 splinemap align "$@"
  [[ ! -s out ]] || fail "an answer: $(cat out)"
  expect_text "$reason" err
}
refused "two places fit" room.splinemap room.splinemap --json
refused "too little in common" whole.splinemap room.splinemap --picture none.png
refused "1000.0 m have to agree" whole.splinemap whole.splinemap --min-wall 1000
[[ ! -e none.png ]] || fail "a picture of nothing"
refused "no map was received on SPLINEMAP_DIGESTS" --live robot-1 robot-2 --timeout 0.5
expect 2 splinemap align both.splinemap robot-1 nobody
expect_text "has no layer nobody" err
expect 2 splinemap align both.splinemap
expect_text "give two map files" err
expect 2 splinemap align --live robot-1
expect 1 splinemap align first.splinemap none.splinemap

# Layers of a bus.
splinemapd --map both.splinemap --name base --no-sensors 2> daemon.log &
await splinemap align --live robot-2 robot-1 --timeout 5
expect 0 splinemap align --live robot-2 robot-1 --json
near 12 -5 130
expect 0 splinemap align --live robot-2 robot-1 --apply
before=$(was)
sleep 2
expect 0 splinemap align --live robot-2 robot-1 --json
near 0 0 0
# shellcheck disable=SC2086
expect 0 splinemap layer place --live robot-1 $before
sleep 2
expect 0 splinemap align --live robot-2 robot-1 --json
near 12 -5 130
expect 2 splinemap align --live robot-2 nobody
expect_text "the bus has no layer nobody" err

# An owner says where its scans lie, and places them beyond that, also where they are not kept.
shown() {
  splinemap layers --live --robot robot-2 --timeout 1.5 --json |
    jq -c '.[0].layers[0] | [.placement.x_m, .placement.y_m, .placement.yaw_deg, .is_approximate]'
}
for kept_mb in 256 0; do
  cp turned.splinemap own.splinemap
  echo "scan { channel: 'LASER' } pose: 'POSE' service { max_archive_mb: $kept_mb }" > own.textproto
  splinemapd --config own.textproto --map own.splinemap --name robot-2 2> own.log &
  owner=$!
  await splinemap layers --live --robot robot-2 --timeout 1.5
  [[ $(shown) == '[12,-5,130,false]' ]] || fail "shown: $(shown)"
  expect 0 splinemap layer place --live robot-2 --robot robot-2 7 -5 130
  sleep 1
  [[ $(shown) == '[7,-5,130,false]' ]] || fail "shown after it was placed: $(shown)"
  # What is shown places it back, to the bit.
  expect 0 splinemap layer place --live robot-2 --robot robot-2 7.123456 -5.654321 33.333333
  sleep 1
  shown=$(shown)
  IFS=, read -r x y yaw _ <<< "${shown//[][]/}"
  expect 0 splinemap layer place --live robot-2 --robot robot-2 "$x" "$y" "$yaw"
  sleep 1
  [[ $(shown) == "$shown" ]] || fail "shown, and placed there: $shown, $(shown)"
  expect 0 splinemap layer place --live robot-2 --robot robot-2 7 -5 130
  sleep 1
  kill "$owner"
  wait "$owner" || fail "daemon: $(cat own.log)"
  expect 0 splinemap align turned.splinemap own.splinemap --json
  near 5 0 0
done
echo "align: files, layers, a bus, and what is refused"
