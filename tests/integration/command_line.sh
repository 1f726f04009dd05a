#!/usr/bin/env bash
# The command line tool and the daemon's flags, as a user types them.
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

cat > room.world << 'EOF'
wall { x0_m: -2 y0_m: -2 x1_m: 2 y1_m: -2 }
wall { x0_m: 2 y0_m: -2 x1_m: 2 y1_m: 2 }
wall { x0_m: 2 y0_m: 2 x1_m: -2 y1_m: 2 }
wall { x0_m: -2 y0_m: 2 x1_m: -2 y1_m: -2 }
waypoint { x_m: -1 } waypoint { x_m: 1 } waypoint { x_m: 1 y_m: 1 }
EOF

# simulate, doctor, build
expect 0 splinemap simulate room.world room.lcmlog --trajectory truth.csv --world-out copy.world
[[ $(head -n 1 truth.csv) == utime_us,x_m,y_m,yaw_rad ]] || fail "header of the trajectory"
expect 0 splinemap simulate copy.world again.lcmlog
cmp room.lcmlog again.lcmlog || fail "the same world and seed make the same log"
expect 2 splinemap simulate room.world again.lcmlog
expect_text "--force" err
expect 0 splinemap simulate room.world again.lcmlog --force
expect 0 splinemap simulate --help
expect_text "splinemap simulate [OPTIONS] [WORLD] OUT" out
expect 2 splinemap build room.lcmlog /dev/null --force
expect 2 splinemap build room.lcmlog no/such/folder
expect 1 splinemap doctor room.lcmlog --pose NOPE
expect_text "there are: POSE" err
expect 0 splinemap doctor room.lcmlog
expect_text "map it with: --scan LASER --pose POSE" out
expect 0 splinemap build room.lcmlog room.splinemap --name robot
[[ ! -s out ]] || fail "build wrote to stdout"
expect_text "mapped" err
expect 2 splinemap build room.lcmlog room.splinemap
expect_text "--force" err
expect 0 splinemap build --scan LASER room.lcmlog --pose POSE room.splinemap --name robot --force
# What another build of the same map has in the making is left alone.
echo another > twin.splinemap.part
mkdir twin.splinemap.part-wal
expect 0 splinemap build room.lcmlog twin.splinemap
[[ $(echo twin.*) == "twin.splinemap twin.splinemap.part twin.splinemap.part-wal" &&
  $(< twin.splinemap.part) == another ]] || fail "files beside a build: $(echo twin.*)"
rm -r twin.*
expect 2 splinemap build room.lcmlog x.splinemap --name 'no/name'
expect 2 splinemap build room.lcmlog x.splinemap --scan LASER:nonsense
expect_text "michigan_2014" err
expect 2 splinemap build room.lcmlog x.splinemap --scan LASR --pose POSE
expect_text "LASR is no channel of scans (did you mean LASER?)" err
[[ ! -e x.splinemap ]] || fail "a build without scans left a map"

# commands
expect 2 splinemap
expect_text "give a command" err
expect 2 splinemap rendr room.splinemap
expect_text "there is no command rendr (did you mean render?)" err
expect 2 splinemap query room.splinemap 1 2 --hesian
expect_text "splinemap query: there is no flag --hesian (did you mean --hessian?); splinemap query --help" err
expect 2 splinemap info room.splinemap other.splinemap
expect_text "splinemap info: other.splinemap is one argument too many" err
expect 2 splinemap layer shft
expect_text "splinemap layer: " err
expect 2 splinemapd --scann LASER --pose POSE
expect_text "splinemapd: there is no flag --scann (did you mean --scan?); splinemapd --help" err

# crop
expect 0 splinemap crop room.splinemap crop.splinemap --region 1.7,-2,2,-1.7
expect 0 splinemap query crop.splinemap 2 -1.8
[[ $(tail -n 1 out) == "$(splinemap query room.splinemap 2 -1.8 | tail -n 1)" ]] || fail "cropped: $(cat out)"
expect 1 splinemap crop room.splinemap nothing.splinemap --region 100,100,101,101
[[ ! -e nothing.splinemap ]] || fail "a crop of nothing"

# points in other ways of writing CSV
for line in '2.0,0.5' '2.0;0.5' '2.0 0.5' $'2.0\t0.5' $' 2.0 , 0.5\r'; do
  printf '\xef\xbb\xbf%s\n' "$line" > points.csv
  expect 0 splinemap query room.splinemap --points points.csv
  [[ $(cut -d , -f 1-3 out) == "$(splinemap query room.splinemap 2.0 0.5 | tail -n 1 | cut -d , -f 1-3)" ]] ||
    fail "$line: $(cat out)"
done
printf '1.0;x\n2.0;0.5\n' > points.csv
expect 2 splinemap query room.splinemap --points points.csv  # the first line is no header

# info, query, render
expect 0 splinemap info room.splinemap --json
[[ $(jq '.layers | length' out) == 1 && $(jq -r '.layers[0].name' out) == robot ]] || fail "layers"
[[ $(jq '.knot_interval_m == 0.05 and .tiles > 0 and .area_m2 > 15 and .area_m2 < 20' out) == true ]] ||
  fail "info: $(cat out)"
expect 0 splinemap query room.splinemap 2.03 0.5
[[ $(head -n 1 out) == x_m,y_m,log_odds,probability,dx_per_m,dy_per_m,known ]] || fail "columns"
awk -F, 'NR == 2 && $3 > 1 && $4 > 0.7 && $7 == 1 { found = 1 } END { exit !found }' out ||
  fail "no wall at (2.03, 0.5): $(cat out)"
expect 0 splinemap query room.splinemap -1.0 -1.5
awk -F, 'NR == 2 && $3 < -1 && $7 == 1 { found = 1 } END { exit !found }' out || fail "not free"
expect 0 splinemap query room.splinemap 50 50
[[ $(tail -n 1 out) == 50,50,0.000000,0.500000,0.000000,0.000000,0 ]] || fail "unknown: $(cat out)"
printf 'x_m,y_m\n2,0.5\n0,0,more\nnan,0\n' > points.csv
expect 0 splinemap query room.splinemap --points points.csv
(($(wc -l < out) == 4)) || fail "one line out per line in: $(cat out)"
printf '0,0\nx\n1,1\n' > points.csv
expect 2 splinemap query room.splinemap --points points.csv
(($(wc -l < out) == 3)) || fail "one line out per line in, broken ones too"
expect_text "points.csv:2:" err
expect 2 splinemap query room.splinemap
expect 0 splinemap render room.splinemap room.png --px-per-knot 3
[[ $(head -c 8 room.png | od -An -tx1 | tr -d ' ') == 89504e470d0a1a0a ]] || fail "no PNG"
expect 2 splinemap render room.splinemap room.splinemap
expect 0 splinemap render room.splinemap
expect_text "####" out
expect 2 splinemap render room.splinemap /dev/null
expect 2 splinemap render room.splinemap no/such/folder.png

# export
expect 0 splinemap export room.splinemap room --format ros
expect_text "room.pgm, room.yaml" err
[[ ! -s out ]] || fail "export wrote to stdout"
grep -qx "image: room.pgm" room.yaml || fail "image in $(cat room.yaml)"
expect 2 splinemap export room.splinemap room --format ros
expect_text "room.pgm exists; --force replaces it" err
rm room.pgm
expect 2 splinemap export room.splinemap room --format ros
expect_text "room.yaml exists" err
expect 0 splinemap export room.splinemap room --format ros --mode scale --force
grep -qx "image: room.png" room.yaml || fail "image in $(cat room.yaml)"
mkdir folder
expect 0 splinemap export room.splinemap folder/part --format ros --mode raw --region -1,-1.5,1.5,0 \
  --resolution 0.1
[[ $(head -n 2 folder/part.pgm | tail -n 1) == "25 15" ]] || fail "size: $(head -n 2 folder/part.pgm)"
grep -qx "origin: \[-1.05, -1.55, 0.0\]" folder/part.yaml || fail "origin: $(cat folder/part.yaml)"
grep -qx "image: part.pgm" folder/part.yaml || fail "a folder in the yaml: $(cat folder/part.yaml)"
expect 0 splinemap export room.splinemap picture --format png --region=-1,-1,1,1
[[ $(tr '\n' ' ' < picture.pgw) == "0.05 0 0 -0.05 -1 0.95 " ]] || fail "$(cat picture.pgw)"
expect 0 splinemap export room.splinemap table --format csv --region -1,-1,1,1 --resolution 0.5
(($(wc -l < table.csv) == 17)) || fail "4 x 4 points: $(cat table.csv)"
tail -n +2 table.csv | cut -d, -f 1,2 > points.csv
expect 0 splinemap query room.splinemap --points points.csv
cmp <(cut -d, -f 1-4,7 out) <(tail -n +2 table.csv) || fail "export and query differ"
expect 0 splinemap export room.splinemap room --format geotiff
# An extension that was typed is not added again.
for typed in png/a.png png/b.pgw csv/c.csv geotiff/d.TIF ros/e.yaml ros/f.pgm; do
  expect 0 splinemap export room.splinemap "folder/${typed#*/}" --format "${typed%/*}"
done
[[ $(cd folder && echo [a-f].*) == "a.pgw a.png b.pgw b.png c.csv d.tif e.pgm e.yaml f.pgm f.yaml" ]] ||
  fail "extensions: $(ls folder)"
grep -qx "image: e.pgm" folder/e.yaml || fail "image in $(cat folder/e.yaml)"
expect 2 splinemap export room.splinemap folder/.png --format png
[[ $(head -c 4 room.tif | od -An -tx1 | tr -d ' ') == 49492a00 ]] || fail "no TIFF"
for hostile in 0,0,1 0,0,1,1,1 a,0,1,1 nan,0,1,1 0,0,inf,1 1,0,0,1 0,0,0,1 -1e9,0,1,1 '0,0,1,1 2'; do
  expect 2 splinemap export room.splinemap x --format csv --region "$hostile"
done
expect_text "X0,Y0,X1,Y1" err
for hostile in 0 -0.05 nan inf 1e-9 x; do
  expect 2 splinemap export room.splinemap x --format csv --resolution "$hostile"
done
expect 2 splinemap export room.splinemap x --format png --region -9999,-9999,9999,9999
expect_text "too large" err
expect 2 splinemap export room.splinemap x --format bmp
expect 2 splinemap export room.splinemap x --format csv --mode raw
expect 2 splinemap export room.splinemap folder/ --format csv
expect 2 splinemap export room.splinemap no/such/folder --format csv
expect 1 splinemap export none.splinemap x --format csv
# A limit on the size of a file stands in for a full disk: what was there stays.
cp room.yaml before.yaml
for format in ros csv geotiff; do
  (
    trap '' XFSZ
    ulimit -f 8
    expect 1 splinemap export room.splinemap room --format $format --resolution 0.001 --force
    expect_text "File too large" err
  )
done
cmp room.yaml before.yaml || fail "a failed export changed a file"
[[ -z $(find . -name 'x.*' -o -name '*.part') ]] || fail "left behind: $(find . -name 'x.*' -o -name '*.part')"

# A file that exists is replaced with --force only, by every command; none replaces its input.
touch old.{splinemap,lcmlog,png,csv,tif,world}
echo "FLASER 4 1 1.5 2 81.9 0.1 0 0 0 0 0 0 host 0" > tiny.log
for command in "build room.lcmlog old.splinemap" "backup room.splinemap old.splinemap" \
  "repair room.splinemap old.splinemap" \
  "flatten room.splinemap old.splinemap" "merge room.splinemap --out old.splinemap" \
  "layer mute room.splinemap robot --out old.splinemap" "render room.splinemap old.png" \
  "raster room.splinemap old.csv --region 0,0,1,1" "export room.splinemap old --format geotiff" \
  "simulate room.world old.lcmlog" "simulate room.world new.lcmlog --trajectory old.csv" \
  "simulate room.world new.lcmlog --world-out old.world" "import-carmen tiny.log old.lcmlog" \
  "snapshot old.splinemap --lcm-url memq://"; do
  read -ra words <<< "$command"
  expect 2 splinemap "${words[@]}"
  grep -qE '^splinemap: old\.[a-z]+ exists; --force replaces it$' err || fail "$command: $(cat err)"
  [[ -z $(find old.* -size +0) && ! -e new.lcmlog ]] || fail "$command has written"
  [[ $command != snapshot* ]] || continue
  expect 0 splinemap "${words[@]}" --force
  [[ -n $(find old.* -size +0) ]] || fail "$command --force has not written"
  rm -f new.lcmlog
  for file in old.*; do : > "$file"; done
done
rm old.*
for command in "build room.lcmlog room.lcmlog" "backup room.splinemap room.splinemap" \
  "repair room.splinemap room.splinemap" \
  "flatten room.splinemap ./room.splinemap" "simulate room.world room.world" \
  "simulate room.world new.lcmlog --world-out room.world" "import-carmen tiny.log tiny.log" \
  "snapshot --log room.lcmlog room.lcmlog"; do
  read -ra words <<< "$command"
  expect 2 splinemap "${words[@]}" --force
  expect_text ": the command reads it" err
done

# Numbers with a leading minus are numbers.
expect 0 splinemap query room.splinemap -1.5 1
[[ $(tail -n 1 out) == -1.5,1,* ]] || fail "query: $(cat out)"
expect 0 splinemap query room.splinemap -.5 -1e-1
[[ $(tail -n 1 out) == -0.5,-0.1,* ]] || fail "query: $(cat out)"
expect 0 splinemap ray room.splinemap -.5 -.25 -90 --max-range .5
expect 0 splinemap check room.splinemap -.5 -.5 -1 -.5 --radius .1
expect 0 splinemap check room.splinemap --radius .1 --occupied -.1 -.5 -.5
expect 0 splinemap raster room.splinemap minus.csv --region -.5,-1,.5,-.2
expect 0 splinemap export room.splinemap minus --format geotiff --region -.5,-1,.5,-.2
expect 2 splinemap query room.splinemap -x 1
expect 2 splinemap query room.splinemap -1x 1
expect_text "-1x is not a number" err

# MAP or --live: one of them.
expect 2 splinemap layers
expect_text "give a map file, --live or --fleet" err
expect 2 splinemap layers room.splinemap other.splinemap
expect 2 splinemap layers --live room.splinemap
expect_text "room.splinemap is one argument too many" err
expect 2 splinemap render --live room.splinemap out.png
expect_text "give one output after --live, which takes the place of the map file" err
expect 2 splinemap layers room.splinemap --robot robot
expect_text "--robot requires --live" err

# diff
cp room.splinemap copy.splinemap
expect 0 splinemap diff room.splinemap copy.splinemap
expect 0 splinemap diff room.splinemap copy.splinemap --json
[[ $(jq -c . out) == '{"differences":[],"equal":true}' ]] || fail "diff: $(cat out)"
expect 0 splinemap simulate room.world noisy.lcmlog --seed 2
expect 0 splinemap build noisy.lcmlog noisy.splinemap --name robot
expect 1 splinemap diff room.splinemap noisy.splinemap
expect_text "tiles differ" out
expect 0 splinemap build room.lcmlog other.splinemap --name other
expect 1 splinemap diff room.splinemap other.splinemap
expect_text "layer other: only in other.splinemap" out
expect 1 splinemap diff room.splinemap noisy.splinemap --json
[[ $(jq -c '[.equal, (.differences[] | [.layer, .sum, .tiles > 0])]' out) == \
  '[false,["robot",null,true],[null,true,true]]' ]] || fail "diff: $(cat out)"

# several channels fit
expect 0 splinemap simulate room.world two.lcmlog --pose-rate 20
sed 's/POSE/ODOM/' two.lcmlog > two_renamed.lcmlog  # a channel name of the same length
cat two_renamed.lcmlog >> two.lcmlog
expect 2 splinemap build two.lcmlog two.splinemap
expect_text "--pose ODOM" err
expect_text "--pose POSE" err
expect 0 splinemap doctor two.lcmlog --json  # the poses that are not as sparse
[[ $(jq -c .chosen_flags out) == '["--scan","LASER","--pose","POSE"]' ]] || fail "doctor: $(cat out)"
[[ $(jq '[.trials[].scans_compared] | unique | length' out) == 1 ]] || fail "the same scans: $(cat out)"
# What may be repeated takes one value each time: what follows is a file.
expect 1 splinemap snapshot --robot one --robot two x.splinemap --lcm-url memq:// --timeout 0.1
expect_text "no map of one, two was received" err
expect 2 splinemap doctor
expect 2 splinemap doctor two.lcmlog --live
expect 2 splinemap doctor two.lcmlog --scan LASER,mask=foo
expect 2 splinemap build two.lcmlog x.splinemap --scan --pose
expect 1 splinemap doctor --live --seconds 0.2 --lcm-url memq://
expect_text "nothing was received" err

# import-carmen
{
  echo "# a CARMEN log"
  for k in 1 2 3; do echo "FLASER 4 1 1.5 2 81.9 0.$k 0 0 0 0 0 0 host 0"; done
  echo "FLASER 4 1 1"
} > small.log
gzip -k small.log
expect 0 splinemap import-carmen small.log small.lcmlog
expect_text "2 scans have time stamps that repeat" err
expect_text "the first is line 5" err
expect 0 splinemap import-carmen small.log.gz small_gz.lcmlog --rate 10
cmp small.lcmlog small_gz.lcmlog || fail "gz differs"
expect 0 splinemap build small.lcmlog small.splinemap
expect_text "mapped 3 of 3 scans" err

# prefix-channels
expect 0 splinemap prefix-channels room.lcmlog one_ one.lcmlog
expect 0 splinemap doctor one.lcmlog
expect_text "map it with: --scan one_LASER --pose one_POSE" out
expect 0 splinemap build one.lcmlog one.splinemap --name robot
expect 0 splinemap diff one.splinemap room.splinemap
expect 2 splinemap prefix-channels room.lcmlog "$(printf 'x%.0s' {1..60})" x.lcmlog
expect_text "LCM has room for 63 bytes" err
expect 2 splinemap prefix-channels room.world one_ x.lcmlog

# render of parts that are far apart
cat > far.world << 'EOF'
wall { x0_m: 5002 y0_m: -2 x1_m: 5002 y1_m: 2 } waypoint { x_m: 5000 }
EOF
expect 0 splinemap simulate far.world far.lcmlog
expect 0 splinemap build far.lcmlog far.splinemap --name far
expect 0 splinemap merge room.splinemap far.splinemap --out parts.splinemap
expect 0 splinemap render parts.splinemap
expect_text "the map has 2 parts that are far apart:" err
expect_text "  16 tiles in -4,-4,4,4" err
expect 1 splinemap crop parts.splinemap x.splinemap --region 100,100,101,101
expect_text "splinemap layers says where they are" err
expect 0 bash -c "$(sed -n 's/^one is kept by \(.*\) OUT \(.*\)/\1 near.splinemap \2/p' err)"
expect 0 splinemap render room.splinemap
[[ ! -s err ]] || fail "one part: $(cat err)"

# errors
expect 2 splinemap
expect 2 splinemap frobnicate
expect 2 splinemap render
expect 0 splinemap --help
expect 0 splinemap --version
# subcommands [COMMAND]: as --help lists them.
subcommands() {
  splinemap "$@" --help | awk '/^Subcommands:/ { inside = 1; next } NF == 0 { inside = 0 } inside { print $1 }'
}
mapfile -t commands < <(subcommands)
((${#commands[@]} == 35)) || fail "commands: ${commands[*]}"
mapfile -t settings < <(subcommands layer | sed 's/^/layer /')
((${#settings[@]} == 6)) || fail "commands of layer: ${settings[*]}"
live=()
fleet=()
json=()
force=()
for command in "${commands[@]}" "${settings[@]}" "bridge occupancy-grid"; do
  read -ra words <<< "$command"
  expect 0 splinemap "${words[@]}" --help
  expect_text "Example" out
  expect_text "splinemap $command" out
  # The same words for the same things.
  if grep -qE '^  --live ' out && [[ $command != doctor ]]; then
    live+=("$command")
    for text in "Map file, " \
      "  --live                      Use the map of the daemons on an LCM bus" \
      "  --lcm-url URL               LCM bus (default: LCM_DEFAULT_URL)" \
      "  --prefix TEXT               channel_prefix of the daemons" "  --robot NAME  " \
      "  --timeout FLOAT             s to wait for the daemons (default "; do
      expect_text "$text" out
    done
  fi
  if grep -q '^  --fleet ' out; then
    fleet+=("$command")
    for text in "  --fleet URL[,URL]..         Use the map of a fleet, on these NATS servers" \
      "  --fleet-map NAME            Name of the map (default map)" "  --credentials FOLDER  " \
      "  --timeout FLOAT             s to wait for the "; do
      expect_text "$text" out
    done
  fi
  if grep -q '^  --region' out; then
    expect_text "--region X0,Y0,X1,Y1" out
    expect_text "Only this part of the map, in metres of the map frame" out
  fi
  if grep -q '^  --json' out; then
    json+=("$command")
    expect_text "  --json                      Print JSON, for programs" out
  fi
  if grep -q '^  --force' out; then
    force+=("$command")
    expect_text "  --force                     Replace a file that exists" out
  fi
done
[[ ${live[*]} == "render export query ray check distance raster align layers correct ${settings[*]}" ]] ||
  fail "take --live: ${live[*]}"
[[ ${fleet[*]} == "render export query ray check distance raster align layers merge watch snapshot ${settings[*]}" ]] ||
  fail "take --fleet: ${fleet[*]}"
[[ ${json[*]} == "info query ray check distance diff align layers changes verify doctor watch" ]] || fail "print JSON: ${json[*]}"
[[ ${force[*]} == "build render export raster align merge flatten changes fold forget correct backup repair crop snapshot simulate import-carmen import-ros prefix-channels ${settings[*]}" ]] ||
  fail "write files: ${force[*]}"
expect 2 splinemap control mute robot
expect 2 splinemap remove room.splinemap robot -o x.splinemap
expect 1 splinemap info none.splinemap
expect_text "there is no file none.splinemap" err
expect 2 splinemap info .
: > empty.splinemap
expect 1 splinemap info empty.splinemap
expect_text "holds no map yet" err
expect 2 splinemap info room.world
expect_text "no map file" err
expect 1 splinemap doctor none.lcmlog
expect 2 splinemap doctor room.world
expect_text "import-carmen" err
expect 2 splinemap import-carmen room.lcmlog x.lcmlog
head -c 100000 room.lcmlog > cut.lcmlog
expect 1 splinemap build cut.lcmlog cut.splinemap
expect_text "ends within event" err
expect 0 splinemap info cut.splinemap  # what came before is there
expect 1 splinemap doctor cut.lcmlog
expect_text "map it with" out

# A map that a daemon left open, killed, is replaced cleanly; one in use is not.
(
  splinemapd --map killed.splinemap --scan LASER --pose POSE --lcm-url memq:// 2> daemon.log &
  daemon=$!
  await test -e killed.splinemap-wal
  await splinemap info killed.splinemap
  expect 1 splinemap build room.lcmlog killed.splinemap --force
  expect_text "in use" err
  kill -KILL "$daemon"
  wait "$daemon" || true
) 2> /dev/null || fail "replacing a map in use"
expect 0 splinemap build room.lcmlog killed.splinemap --force --name robot
expect 0 splinemap diff room.splinemap killed.splinemap

# the daemon's configuration
expect 0 splinemapd --scan LASER --pose POSE --print-config
cmp out "$top/deploy/config/splinemapd.textproto" || fail "the shipped configuration is out of date"
expect 0 splinemapd --scan LASER --pose POSE --no-remote-commands --print-config
expect_text "  remote_commands: false" out
expect 0 splinemapd --config "$top/deploy/config/splinemapd.textproto" --check-config
expect 2 splinemapd
expect_text "--scan" err
expect 2 splinemapd --scan LASER --pose POSE --nonsense
printf 'pose: "POSE"\nscan { channel: "LASER" }\nmethod {\n  knot_interval_m: nan\n}\n' > bad.textproto
expect 2 splinemapd --config bad.textproto --check-config
expect_text "bad.textproto:4:3: knot_interval_m is nan" err
expect 1 splinemapd --scan LASER --pose POSE --map no/such/folder/map --lcm-url memq://
expect 1 splinemapd --scan LASER --pose POSE --lcm-url nonsense://

echo "command_line: all is well"
