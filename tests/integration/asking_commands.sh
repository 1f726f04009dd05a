#!/usr/bin/env bash
# The commands that take MAP or --live print the same of a daemon, on a bus of its own, as of its map file.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

# Without a daemon each fails within its timeout. All take the same flags.
for command in "query 0 0" "ray 0 0 0" "check 0 0 --radius 0.1" "distance 0 0" "layers" \
  "raster none.png --region -1,-1,1,1" "render none.png" "export none --format png" \
  "layer mute robot"; do
  read -ra words <<< "$command"
  expect 1 timeout 10 splinemap "${words[@]}" --live --timeout 0.3 --lcm-url "$LCM_DEFAULT_URL" \
    --prefix SPLINEMAP --robot robot
  [[ -s err && ! -s out ]] || fail "$command: $(cat out err)"
  expect_text "SPLINEMAP" err
done
[[ ! -e none.png ]] || fail "a picture of nothing"

cat > room.world << 'END'
wall { x0_m: -2 y0_m: -2 x1_m: 2 y1_m: -2 }
wall { x0_m: 2 y0_m: -2 x1_m: 2 y1_m: 2 }
wall { x0_m: 2 y0_m: 2 x1_m: -2 y1_m: 2 }
wall { x0_m: -2 y0_m: 2 x1_m: -2 y1_m: -2 }
waypoint { x_m: -1 } waypoint { x_m: 1 } waypoint { x_m: 1 y_m: 1 }
END
expect 0 splinemap simulate room.world room.lcmlog
expect 0 splinemap build room.lcmlog room.splinemap --name robot
# Without scans a layer is placed where it is read; archive.sh places others.
printf 'service { max_archive_mb: 0 }\n' > without_scans.textproto
splinemapd --map room.splinemap --name robot --scan LASER --pose POSE --config without_scans.textproto \
  2> daemon.log &
daemon=$!
await splinemap query --live 0 0
expect 0 splinemap snapshot saved.splinemap

# same STATUS COMMAND WORD..: of the file and of the daemon.
same() {
  local wanted=$1 command=$2
  shift 2
  expect "$wanted" splinemap "$command" saved.splinemap "$@"
  mv out of_file
  expect "$wanted" splinemap "$command" "$@" --live
  [[ -s out ]] || fail "no answer: $command $*"
  cmp out of_file ||
    fail "$command $*: $(head -n 3 of_file) is of the file, $(head -n 3 out) of the daemon"
}
same 0 query -1.0 -1.5
same 0 query 2.0 0.5 --hessian
[[ $(head -n 1 out) == *,known,dxx_per_m2,dxy_per_m2,dyy_per_m2 ]] || fail "columns: $(cat out)"
same 0 query 50 50
expect 0 splinemap query 50 50 --live --robot robot
same 0 ray -0.5 -0.25 -90
awk -F, 'NR == 2 && $1 == "occupied" && $2 > 1.6 && $2 < 1.8 { found = 1 }
  END { exit !found }' out ||
  fail "no wall at y = -2: $(cat out)"
same 0 ray 0 0 45 --max-range 0.5
[[ $(tail -n 1 out) == free,0.500000 ]] || fail "not free: $(cat out)"
same 0 ray 10 10 0
[[ $(tail -n 1 out) == unknown,0.000000 ]] || fail "not unknown: $(cat out)"
same 0 ray 10 10 0 --unknown free
[[ $(tail -n 1 out) == free,30.000000 ]] || fail "not passed: $(cat out)"
same 0 ray 0 0 0 --occupied -0.5
same 0 check -1 -1 1 -1 1 1 --radius 0.2
[[ $(tail -n 1 out) == free,?,4.000000,nan,nan ]] || fail "not free: $(cat out)"
same 1 check -1 -1 3 -1 --radius 0.2
[[ $(tail -n 1 out) == occupied,* ]] || fail "through the wall: $(cat out)"
same 1 check 20 20 --radius 0.2
same 0 check 20 20 --radius 0.2 --unknown free
same 0 distance -1 -1.5
awk -F, 'NR == 2 && $1 > 0.3 && $1 < 0.6 && $3 > 0.9 { found = 1 } END { exit !found }' out ||
  fail "the wall is half a metre below: $(cat out)"
same 0 distance 0 0 --max-distance 0.1
[[ $(tail -n 1 out) == 0.100000,0.000000,0.000000,0 ]] || fail "distance: $(cat out)"

# Files, more lines than one batch over the bus has.
awk 'BEGIN { print "x_m,y_m,bearing_deg"
  for (k = 0; k < 10500; ++k) printf "%.3f,%.3f,%d\n", sin(k), cos(3 * k), k % 360 - 180
}' > rows.csv
same 0 query --points rows.csv
(($(wc -l < out) == 10501)) || fail "one line out per line in: $(wc -l < out)"
same 0 ray --rays rows.csv
(($(wc -l < out) == 10501)) || fail "one line out per line in: $(wc -l < out)"
head -n 500 rows.csv > few.csv
same 0 distance --points few.csv
printf '0,0,1\nx\n1,nan,2\n1,1,1\n' > broken.csv
same 2 ray --rays broken.csv
[[ $(sed -n 2,3p out | uniq) == unknown,nan ]] || fail "lines: $(cat out)"
(($(wc -l < out) == 4)) || fail "lines: $(cat out)"
expect_text "broken.csv:2: not x_m,y_m,bearing_deg: x" err
same 2 distance --points broken.csv

# JSON has the same names and numbers; a header is no row.
same 0 query -1.0 -1.5 --json
[[ $(jq -c '[.x_m, .y_m, .known, keys[0]]' out) == '[-1,-1.5,1,"dx_per_m"]' ]] || fail "JSON: $(cat out)"
same 0 ray -0.5 -0.25 -90 --json
[[ $(jq '.occupancy == "occupied" and .range_m > 1.6' out) == true ]] || fail "JSON: $(cat out)"
same 0 distance 0 0 --max-distance 0.1 --json
[[ $(jq .distance_m out) == 0.1 ]] || fail "JSON: $(cat out)"
same 1 check -1 -1 3 -1 --radius 0.2 --json
[[ $(jq -r .occupancy out) == occupied ]] || fail "JSON: $(cat out)"
same 2 ray --rays broken.csv --json
[[ $(jq -c '[.occupancy, .range_m]' out | sed -n 2p) == '["unknown",null]' ]] || fail "JSON: $(cat out)"
same 0 distance --points few.csv --json
(($(wc -l < out) == 499)) || fail "one object per row: $(wc -l < out)"

# Pictures of the followed map.
for live in "saved.splinemap" "--live --robot r*t"; do
  read -ra words <<< "$live"
  expect 0 splinemap render "${words[@]}" "render_${#words[@]}.png" --px-per-knot 3
  expect 0 splinemap export "${words[@]}" "export_${#words[@]}" --format ros
done
cmp render_1.png render_3.png || fail "render --live differs"
cmp export_1.pgm export_3.pgm || fail "export --live differs"
expect 0 splinemap render --live
expect_text "####" out

# The layers of the daemon, and a setting of one.
expect 0 splinemap layers saved.splinemap --json
content='[.hash, .area_m2, .box_m, .contradicted, .tiles]'
[[ $(jq -c ".[0] | $content" out) == "$(splinemap layers --live --robot robot --json |
  jq -c ".[0].layers[0] | $content")" ]] || fail "layers --live differs: $(cat out)"
expect 0 splinemap layer mute --live robot
expect_text "mute robot@" err
expect_text "saved by the daemon of robot" err
[[ $(splinemap layers --live --json | jq '.[0].layers[0].muted') == true ]] || fail "not muted"
expect 0 splinemap query --live -1.0 -1.5 --json
[[ $(jq .known out) == 0 ]] || fail "muted, and yet: $(cat out)"
expect 0 splinemap layer unmute --live robot
expect 0 splinemap layer place --live robot 0.12 -0.05 30.5
[[ $(splinemap layers --live --json | jq -c '.[0].layers[0] | [.placement, .is_approximate]') == \
  '[{"x_m":0.12,"y_m":-0.05,"yaw_deg":30.5},true]' ]] || fail "not placed: $(splinemap layers --live)"
expect 0 splinemap layers --live
expect_text "placed at 0.12, -0.05 m, 30.5 deg, approximate" out
# In a file it is the same map.
expect 0 splinemap layer place saved.splinemap robot 0.12 -0.05 30.5 --out placed.splinemap
for point in "-1.0 -1.5" "0.5 0.5" "1.3 -0.2"; do
  read -ra words <<< "$point"
  [[ $(splinemap query --live "${words[@]}" --json) == "$(splinemap query placed.splinemap "${words[@]}" --json)" ]] ||
    fail "placed live, and in a file: another value at $point"
done
expect 0 splinemap layer place --live robot 0.1 -0.05 0
[[ $(splinemap layers --live --json | jq -c '.[0].layers[0].is_approximate') == false ]] || fail "a shift is exact"
expect 2 splinemap layer place --live robot 4e7 0 0
expect_text "a layer can be placed within 33554 km at most" err
expect 0 splinemap layer place --live robot 0 0 0
same 0 query -1.0 -1.5

# Rasters
for out in part.png part.csv; do
  expect 0 splinemap raster saved.splinemap "of_file_$out" --region -1,-1,2.5,1.5 --resolution 0.02
  expect 0 splinemap raster --live "$out" --region=-1,-1,2.5,1.5 --resolution 0.02
  cmp "$out" "of_file_$out" || fail "rasters differ: $out"
done
expect 2 splinemap raster --live part.png --region -1,-1,2.5,1.5
expect_text "--force" err
# What export evaluates, rounded to 1/256.
expect 0 splinemap export saved.splinemap export --format csv \
  --region -1,-1,2.5,1.5 --resolution 0.02
paste -d, part.csv export.csv | awk -F, 'NR > 1 && ($1 != $6 || $2 != $7 || $5 != $10 ||
  ($5 && ($3 - $8) ^ 2 > 0.0041 ^ 2)) { bad = 1 } END { exit bad || NR < 1000 }' ||
  fail "raster and export differ"

# Bad input
refused() {
  local text=$1
  shift
  expect 2 splinemap "$@"
  expect_text "$text" err
}
for command in query ray distance; do
  refused "give a map file, --live or --fleet" $command
  refused "give X Y" $command saved.splinemap 1
  refused "give X Y" $command --live
  refused "nan is no coordinate" $command saved.splinemap 1 nan
  refused "1,2 is not a number; numbers are separated by spaces" $command saved.splinemap 1,2
  refused "saved.splinemap is not a number; --live takes the place" $command saved.splinemap 1 2 3 --live
  refused "requires --live" $command saved.splinemap 1 2 --robot robot
done
refused "give X Y, or --points FILE in their place" query saved.splinemap 1 2 --points few.csv
refused "render_1.png exists; --force replaces it" render --live render_1.png
refused "export_1.pgm exists; --force replaces it" export --live export_1 --format ros
refused "excludes" layer mute --live robot --out x.splinemap
refused "the bus has no layer rbot (did you mean robot?)" layer mute --live rbot
refused "give the layer to change" layer mute --live
refused "nan is no coordinate" ray --live 0 nan 0
refused "ray 0 is from" ray saved.splinemap 0 0 0 --max-range -1
refused "--unknown" ray saved.splinemap 0 0 0 --unknown maybe
refused "max_distance_m is 1000" distance --live 0 0 --max-distance 1000
refused "--radius is required" check saved.splinemap 0 0
refused "there are 3 numbers" check saved.splinemap 0 0 1 --radius 0.1
refused "radius_m of sweep 0 is -1" check --live 0 0 --radius -1
refused "does not end in .png or .csv" raster --live part.gif --region 0,0,1,1
refused "--region is required" raster --live new.png
refused "X0,Y0,X1,Y1" raster --live new.png --region 0,0,1
refused "too large" raster --live new.png --region=-9999,-9999,9999,9999
refused "give one output after the map file" raster saved.splinemap --region 0,0,1,1
refused "give one output after --live" raster --live saved.splinemap new.png --region 0,0,1,1
expect 1 splinemap ray none.splinemap 0 0 0
expect_text "there is no file none.splinemap" err
expect 1 splinemap query --live 0 0 --robot nobody --timeout 0.5
expect_text "nobody" err

# Commands to a daemon, and two daemons that do not follow each other
expect 0 splinemap save
expect_text "the daemon of robot saved its map" err
splinemapd --map other.splinemap --name other --scan OTHER --pose OTHER_POSE --follow other 2> other.log &
other=$!
await splinemap query --live 0 0 --robot other
expect 0 splinemap query --live 0 0
expect_text "have another map. Choose with --robot" err
expect 0 splinemap query --live 0 0 --robot robot
[[ ! -s err ]] || fail "a robot was chosen: $(cat err)"
kill "$other"
wait "$other" || fail "the other daemon: $(cat other.log)"
refused "--robot is required" clear
expect 0 splinemap clear --robot robot
expect 0 splinemap layers --live --json
[[ $(jq '[.[].layers[] | select(.name == "robot").tiles] | add' out) == 0 ]] || fail "cleared: $(cat out)"
kill "$daemon"
wait "$daemon" || fail "the daemon: $(cat daemon.log)"
echo "asking_commands: all is well"
