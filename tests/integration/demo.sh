#!/usr/bin/env bash
# deploy/demo.sh with the programs on the PATH, for logs of one robot and of two.
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

for x in 1 -1; do
  cat > "room$x.world" << EOF
wall { x0_m: -2 y0_m: -2 x1_m: 2 y1_m: -2 } wall { x0_m: 2 y0_m: -2 x1_m: 2 y1_m: 2 }
wall { x0_m: 2 y0_m: 2 x1_m: -2 y1_m: 2 } wall { x0_m: -2 y0_m: 2 x1_m: -2 y1_m: -2 }
waypoint { x_m: $x } waypoint { x_m: $x y_m: 1 }
EOF
  expect 0 splinemap simulate "room$x.world" "room$x.lcmlog"
  expect 0 splinemap build "room$x.lcmlog" "room$x.splinemap" --name "robot$x"
done

# same MAP OTHER: the sums are the same.
same() {
  expect 0 splinemap flatten "$1" flat_1.splinemap --force
  expect 0 splinemap flatten "$2" flat_2.splinemap --force
  expect 0 splinemap export flat_1.splinemap flat_1 --format geotiff --force
  expect 0 splinemap export flat_2.splinemap flat_2 --format geotiff --force
  cmp flat_1.tif flat_2.tif || fail "$1 is not $2"
}

expect 0 "$top/deploy/demo.sh" --installed room1.lcmlog --scan LASER --pose POSE
same demo/demo.splinemap room1.splinemap
[[ -s demo/map.png ]] || fail "no picture"
rm demo/map.png

expect 0 "$top/deploy/demo.sh" --installed --two-robots room1.lcmlog room-1.lcmlog
expect_text "robot-1@" out
expect_text "robot-2@" out
expect_text "The map of both: " out
expect 0 splinemap merge room1.splinemap room-1.splinemap -o both.splinemap
for k in 1 2; do same "demo/robot-$k.splinemap" both.splinemap; done
for picture in map robot-1 robot-2; do [[ -s demo/$picture.png ]] || fail "no $picture.png"; done

expect 2 "$top/deploy/demo.sh" --installed --two-robots room1.lcmlog
expect_text "usage:" err
expect 1 "$top/deploy/demo.sh" --installed --two-robots room1.lcmlog none.lcmlog
expect_text "cannot read none.lcmlog" err

echo "demo: all is well"
