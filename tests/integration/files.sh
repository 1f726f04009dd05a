#!/usr/bin/env bash
# Damaged and foreign files, full and read-only disks, two daemons on one map: each is said in words,
# nothing that can be read is lost, and no half file is left.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# File systems of its own, where the system allows that.
if [[ ${3:-} != mounts && ${3:-} != no_mounts ]]; then
  if unshare -m mount -t tmpfs none /mnt 2> /dev/null; then
    exec unshare -m "$0" "$1" inside mounts
  fi
  exec "$0" "$1" inside no_mounts
fi
mounts=$3
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

# overwrite FILE PLACE COUNT: zeros in place of what is there.
overwrite() { dd if=/dev/zero of="$1" bs=1 seek="$2" count="$3" conv=notrunc status=none; }

splinemap simulate office.lcmlog 2> /dev/null
splinemap build office.lcmlog office.splinemap --name robot 2> /dev/null

# --- LCM logs
size=$(stat -c %s office.lcmlog)
cp office.lcmlog damaged.lcmlog
overwrite damaged.lcmlog $((size / 4)) 3000
overwrite damaged.lcmlog $((size / 2)) 5000
expect 1 splinemap doctor damaged.lcmlog
expect_text "damaged.lcmlog is damaged: skipped" err
expect_text "gaps: 2, the first at byte" err
expect_text "map it with: --scan LASER --pose POSE" out
expect 1 splinemap build damaged.lcmlog damaged.splinemap
expect_text "gaps: 2" err
mapped=$(sed -n 's/^mapped \([0-9]*\) of .*/\1/p' err)
((mapped > 1600)) || fail "only $mapped scans of a log with two gaps"
expect 0 splinemap info damaged.splinemap
head -c $((size / 2)) office.lcmlog > cut.lcmlog
expect 1 splinemap build cut.lcmlog cut.splinemap
expect_text "cut.lcmlog ends within event" err
expect 0 splinemap info cut.splinemap
gzip -k office.lcmlog
expect 0 splinemap build office.lcmlog.gz gz.splinemap --name robot
expect 0 splinemap diff gz.splinemap office.splinemap
head -c 200000 office.lcmlog.gz > cut.lcmlog.gz
expect 1 splinemap build cut.lcmlog.gz cut_gz.splinemap
expect 0 splinemap info cut_gz.splinemap
: > empty.lcmlog
expect 2 splinemap build empty.lcmlog x.splinemap

# --- CARMEN logs
for k in {1..300}; do echo "FLASER 4 1 1.5 2 8$((k % 10)) 0.$k 0 0 0 0 0 $k.5 host $k.5"; done > whole.log
gzip -k whole.log
head -c $(($(stat -c %s whole.log.gz) / 2)) whole.log.gz > cut.log.gz
expect 1 splinemap import-carmen cut.log.gz cut_carmen.lcmlog
expect_text "cut.log.gz is cut off or corrupt; cut_carmen.lcmlog has what precedes" err
expect 0 splinemap doctor cut_carmen.lcmlog
sed '7s/ 0 0 0 0 .*//; 9s/ 1.5 / x /' whole.log > broken.log
expect 0 splinemap import-carmen broken.log broken.lcmlog
expect_text "2 lines could not be read and were skipped, the first is line 7" err

# --- maps of map_server
expect 0 splinemap export office.splinemap lab --format ros
expect 0 splinemap import-ros lab.yaml lab.splinemap --name lab
expect_text "485 x 266 cells of 0.05 m" err
expect 0 splinemap export lab.splinemap again --format ros
cmp <(tail -n +2 lab.yaml) <(tail -n +2 again.yaml) || fail "another grid: $(cat again.yaml)"
# kept VALUE: the share of pixels of that value that came back, in 1/1000.
kept() {
  paste <(tail -n +4 lab.pgm | od -An -v -w1 -tu1) <(tail -n +4 again.pgm | od -An -v -w1 -tu1) |
    awk -v value="$1" '$1 == value { all++; same += $2 == value }
      END { print int(1000 * same / all) }'
}
(($(kept 0) >= 995 && $(kept 254) >= 996 && $(kept 205) == 1000)) ||
  fail "of occupied, free and unknown pixels came back: $(kept 0), $(kept 254), $(kept 205)"
# A map of yesterday: one wall is gone since then, a new one is there. The robot corrects it.
cat > room.world << 'EOF'
wall { x0_m: -4 y0_m: -4 x1_m: 4 y1_m: -4 } wall { x0_m: 4 y0_m: -4 x1_m: 4 y1_m: 4 }
wall { x0_m: 4 y0_m: 4 x1_m: -4 y1_m: 4 } wall { x0_m: -4 y0_m: 4 x1_m: -4 y1_m: -4 }
EOF
sed '$a wall { x0_m: 2 y0_m: -1 x1_m: 2 y1_m: 1 }
  $a waypoint { x_m: 3 } waypoint { x_m: 0 } waypoint { x_m: -3 }' room.world > yesterday.world
sed '$a wall { x0_m: -2 y0_m: -1 x1_m: -2 y1_m: 1 } waypoint { y_m: 1 } waypoint { y_m: -1 }' \
  room.world > today.world
for day in yesterday today; do
  expect 0 splinemap simulate $day.world $day.lcmlog
  expect 0 splinemap build $day.lcmlog $day.splinemap --name robot
done
expect 0 splinemap export yesterday.splinemap yesterday --format ros
expect 0 splinemap import-ros yesterday.yaml imported.splinemap
expect 0 splinemap merge imported.splinemap today.splinemap -o corrected.splinemap
# value MAP X Y: log-odds there, in hundredths.
value() { splinemap query "$@" | tail -n 1 | awk -F, '{ print int(100 * $3) }'; }
for y in -0.8 0 0.8; do
  (($(value imported.splinemap 2 $y) > 0 && $(value corrected.splinemap 2 $y) < 0)) ||
    fail "a wall that is gone: $(value imported.splinemap 2 $y), $(value corrected.splinemap 2 $y)"
  (($(value imported.splinemap -2 $y) < 0 && $(value corrected.splinemap -2.04 $y) > 0)) ||
    fail "a new wall: $(value imported.splinemap -2 $y), $(value corrected.splinemap -2.04 $y)"
done
(($(value corrected.splinemap 4.03 3) > 0)) || fail "a wall that both have"
printf 'method { knot_interval_m: 0.1 }\n' > coarse.textproto
expect 0 splinemap import-ros lab.yaml coarse.splinemap --config coarse.textproto \
  --occupied-log-odds 5 --free-log-odds -1
[[ $(splinemap info coarse.splinemap --json | jq .knot_interval_m) == 0.1 ]] || fail "knot interval"
expect 2 splinemap import-ros lab.yaml x.splinemap --name 'no/name'
expect 2 splinemap import-ros lab.yaml x.splinemap --free-log-odds 1
expect 1 splinemap import-ros none.yaml x.splinemap
expect_text "there is no file none.yaml" err
cp lab.pgm cut.pgm
truncate -s 1000 cut.pgm
sed 's/lab.pgm/cut.pgm/' lab.yaml > cut.yaml
expect 1 splinemap import-ros cut.yaml x.splinemap
expect_text "cut.pgm is cut off" err
sed 's/0.05$/50/' lab.yaml > large.yaml
expect 2 splinemap import-ros large.yaml x.splinemap
expect_text "Is the resolution of 50 m per cell right?" err
sed 's/lab.pgm/none.pgm/' lab.yaml > no_image.yaml
expect 1 splinemap import-ros no_image.yaml x.splinemap
expect_text "there is no file none.pgm" err
for file in office.splinemap whole.log office.lcmlog; do
  expect 2 splinemap import-ros "$file" x.splinemap
done
expect 2 splinemap import-ros lab.yaml lab.pgm --force
expect_text "cannot write lab.pgm: the command reads it" err
[[ ! -e x.splinemap ]] || fail "something was written"

# --- foreign files in every place
splinemap render office.splinemap picture.png 2> /dev/null
sqlite3 foreign.db "CREATE TABLE t (x); INSERT INTO t VALUES (1)"
cp office.splinemap newer.splinemap
sqlite3 newer.splinemap "PRAGMA user_version = 99"
for file in picture.png whole.log foreign.db office.lcmlog; do
  expect 2 splinemap info "$file"
  expect_text "$file is no map file" err
  expect 1 splinemapd --map "$file" --scan LASER --pose POSE
  expect_text "$file is no map file" err
done
for file in picture.png whole.log foreign.db office.splinemap; do
  expect 2 splinemap build "$file" x.splinemap
  expect_text "$file is no LCM log" err
  expect 2 splinemapd --config "$file" --check-config
done
for file in picture.png office.lcmlog foreign.db; do
  expect 2 splinemap import-carmen "$file" x.lcmlog
done
expect 1 splinemap info newer.splinemap
expect_text "a newer splinemap" err
expect 1 splinemapd --map newer.splinemap --scan LASER --pose POSE
expect 2 splinemap info .
expect_text "it is a folder" err
[[ ! -e x.splinemap && ! -e x.lcmlog ]] || fail "something was written"

# --- damaged maps: every command tells, shows what is left and fails
cp office.splinemap tile.splinemap
sqlite3 tile.splinemap "UPDATE tile SET content = x'28b52ffd' WHERE rowid = 7"
expect 1 splinemap info tile.splinemap
expect_text "tile.splinemap: layer robot: tile (" err
expect_text "cannot be read" err
expect_text "layer robot" out
expect 1 splinemap render tile.splinemap tile.png
expect_text "cannot be read" err
[[ -s tile.png ]] || fail "no picture of a damaged map"
expect 1 splinemap query tile.splinemap 1 1
expect_text "x_m,y_m,log_odds" out
expect 1 splinemap diff tile.splinemap tile.splinemap
cp office.splinemap missing.splinemap
sqlite3 missing.splinemap "DELETE FROM tile WHERE rowid = 7"
expect 1 splinemap info missing.splinemap
expect_text "the tiles are not those that were saved" err
cp office.splinemap record.splinemap
sqlite3 record.splinemap "UPDATE map SET record = zeroblob(length(record))"
expect 1 splinemap info record.splinemap
expect_text "the record of the map cannot be read; its copy is used" err
cp office.splinemap options.splinemap
sqlite3 options.splinemap "DELETE FROM map; DELETE FROM layer"
expect 1 splinemap info options.splinemap
expect_text "no record of its knot interval is left" err
expect 1 splinemapd --map options.splinemap --scan LASER --pose POSE --name robot
expect_text "no record of its knot interval is left" err
head -c "$(($(stat -c %s office.splinemap) / 2))" office.splinemap > cut_map.splinemap
cp office.splinemap page.splinemap
overwrite page.splinemap 40960 4096
cp office.splinemap first_page.splinemap
overwrite first_page.splinemap 0 4096
for file in record cut_map page first_page; do
  expect 1 splinemap render "$file.splinemap" "$file.png"
  expect_text "$file.splinemap" err
  [[ -s $file.png ]] || fail "no picture of what is left of $file"
  expect 1 splinemap merge "$file.splinemap" -o merged.splinemap
  expect_text "$file.splinemap is corrupt; nothing is written" err
  [[ ! -e merged.splinemap ]] || fail "a damaged map was merged"
  expect 1 splinemap merge --accept-corrupt "$file.splinemap" -o merged.splinemap
  expect_text "$file.splinemap" err
  expect 0 splinemap info merged.splinemap
  rm merged.splinemap
  before=$(md5sum < "$file.splinemap")
  expect 1 splinemap repair "$file.splinemap" "${file}_repaired.splinemap"
  grep -qE '^robot@[0-9a-f]+: (all [0-9]+|[0-9]+ of [0-9]+) tiles, (all [0-9]+|[0-9]+ of [0-9]+) scans' out ||
    fail "repair does not say what was lost: $(cat out)"
  expect_text "what can be read of $file.splinemap is in ${file}_repaired.splinemap" err
  expect 0 splinemap info "${file}_repaired.splinemap"
  [[ $(md5sum < "$file.splinemap") == "$before" ]] || fail "repair changed $file.splinemap"
  expect 0 timeout --preserve-status 2 \
    splinemapd --map "$file.splinemap" --scan LASER --pose POSE --name robot
  expect_text "the corrupt one is kept as $file.splinemap" err
  expect 0 splinemap info "$file.splinemap"
  expect 1 splinemap info "$file".splinemap.*.damaged
done
expect 0 splinemap diff first_page.splinemap office.splinemap
expect 0 splinemap diff first_page_repaired.splinemap office.splinemap
# A tile that is lost comes back from the scans.
expect 1 splinemap repair tile.splinemap tile_repaired.splinemap
tiles=$(splinemap info office.splinemap --json | jq '.layers[0].tiles')
expect_text ": $((tiles - 1)) of $tiles tiles, all " out
expect_text "splinemap fold makes the tiles anew of the scans" out
expect 1 splinemap verify tile_repaired.splinemap
expect 0 splinemap fold tile_repaired.splinemap --out tile_folded.splinemap
expect 0 splinemap export tile_folded.splinemap tile_folded --format geotiff
expect 0 splinemap export office.splinemap office --format geotiff
cmp tile_folded.tif office.tif || fail "the tile that was lost is another one"
expect 0 splinemap repair office.splinemap office_repaired.splinemap
expect_text "all of office.splinemap is in office_repaired.splinemap" err
expect 0 splinemap diff office_repaired.splinemap office.splinemap
expect 1 splinemap repair options.splinemap x.splinemap
[[ ! -e x.splinemap ]] || fail "a map of nothing was written"

# --- two daemons on one map
listen=(--scan LASER --pose POSE --name robot)
cp office.splinemap shared.splinemap
splinemapd --map shared.splinemap "${listen[@]}" 2> daemon.log &
daemon=$!
await splinemap watch --once --timeout 2
expect 1 splinemapd --map shared.splinemap "${listen[@]}"
expect_text "shared.splinemap is in use by another process" err
cp shared.splinemap copy_in_use.splinemap
kill "$daemon"
wait "$daemon" || fail "the first daemon: $(cat daemon.log)"
expect 0 splinemap diff shared.splinemap office.splinemap

# --- backups of a map that a daemon goes on saving
printf 'service { save_interval_s: 0.1 }\n' > often.textproto
splinemapd --config often.textproto --map live.splinemap "${listen[@]}" 2> daemon.log &
daemon=$!
await splinemap watch --once --timeout 2
lcm-logplayer -s 5 office.lcmlog > /dev/null &
player=$!
for k in {1..20}; do
  expect 0 splinemap backup live.splinemap backup_$k.splinemap
  expect 0 splinemap info backup_$k.splinemap
done
wait "$player"
kill "$daemon"
wait "$daemon" || fail "the daemon that was copied: $(cat daemon.log)"
expect 2 splinemap backup live.splinemap backup_1.splinemap
expect_text "--force replaces it" err
expect 0 splinemap backup live.splinemap backup_1.splinemap --force
expect 0 splinemap diff live.splinemap backup_1.splinemap
for file in tile cut_map first_page; do
  rm -f "$file.splinemap"
  cp office.splinemap "$file.splinemap"
done
sqlite3 tile.splinemap "UPDATE tile SET content = x'28b52ffd' WHERE rowid = 7"
truncate -s "$(($(stat -c %s office.splinemap) / 2))" cut_map.splinemap
overwrite first_page.splinemap 0 4096
for file in tile cut_map first_page; do
  expect 1 splinemap backup "$file.splinemap" "backup_$file.splinemap"
  expect_text "$file.splinemap is damaged; nothing is written. splinemap repair writes what can be" err
done
[[ -z $(find . -name 'backup_[a-z]*') ]] || fail "left behind: $(find . -name 'backup_[a-z]*')"

# --- killed commands: the next one removes what they left
mkdir killed
for k in {1..10}; do
  splinemap build office.lcmlog killed/x.splinemap 2> /dev/null &
  command=$!
  sleep "0.$k"
  kill -9 "$command" 2> /dev/null || true
  wait "$command" 2> /dev/null || true
  rm -f killed/x.splinemap
done
splinemap simulate killed/y.lcmlog 2> /dev/null &
command=$!
until compgen -G 'killed/y.lcmlog.*.part' > /dev/null; do sleep 0.01; done
kill -9 "$command"
wait "$command" 2> /dev/null || true
compgen -G 'killed/y.lcmlog.*.part' > /dev/null || fail "nothing was left to be removed"
expect 0 splinemap build office.lcmlog killed/x.splinemap
expect 0 splinemap simulate killed/y.lcmlog
[[ $(cd killed && echo *) == "x.splinemap y.lcmlog" ]] || fail "left behind: $(ls killed)"
rm killed/y.lcmlog
splinemap simulate killed/y.lcmlog 2> /dev/null &
command=$!
until compgen -G 'killed/y.lcmlog.*.part' > /dev/null; do sleep 0.01; done
kill -TERM "$command"
wait "$command" && fail "a command that was ended is not done"
[[ $(cd killed && echo *) == x.splinemap ]] || fail "left behind: $(ls killed)"

if [[ $mounts == no_mounts ]]; then
  echo "files: full and read-only disks skipped, no file system can be mounted here"
  exit 0
fi

# --- a full disk, for what writes a file
trap 'umount full fixed 2> /dev/null; clean_up' EXIT
mkdir full
mount -t tmpfs -o size=8m none full
fill() { cat /dev/zero > full/ballast 2> /dev/null || true; }
fill
expect 1 splinemap simulate full/x.lcmlog
expect_text "cannot write full/x.lcmlog: No space left on device" err
expect 1 splinemap import-carmen whole.log full/x.lcmlog
expect 1 splinemap build office.lcmlog full/x.splinemap
expect_text "the disk is full" err
expect 1 splinemap merge office.splinemap -o full/x.splinemap
expect_text "the disk is full" err
expect 1 splinemap render office.splinemap full/x.png
expect_text "cannot write full/x.png" err
[[ $(ls full) == ballast ]] || fail "half files: $(ls full)"
expect 1 splinemapd --map full/x.splinemap "${listen[@]}"
expect_text "full/x.splinemap: the disk is full" err

# --- a disk that is full while the daemon maps, and then is not
printf 'service { save_interval_s: 0.3 }\n' > often.textproto
status() { splinemap watch --once --json --timeout 2 > status.json; }
has() { status && [[ $(jq "$1" status.json) == true ]]; }
rm full/*
splinemapd --config often.textproto --map full/live.splinemap "${listen[@]}" 2> daemon.log &
daemon=$!
await has '.saved_revision == .revision'
fill
messages=$(splinemap doctor office.lcmlog --json | jq '[.channels[].messages] | add')
lcm-logplayer -s 20 office.lcmlog > /dev/null
await has ".messages_received == $messages"
await grep -q "the map is not saved: cannot write full/live.splinemap: the disk is full" daemon.log
has '.scans_mapped > 1600 and .saved_revision < .revision and (.last_problem | contains("full"))' ||
  fail "on a full disk: $(cat status.json)"
rm full/ballast
await has '.saved_revision == .revision'
fill
kill "$daemon"
wait "$daemon" || fail "all was saved, and yet: $(cat daemon.log)"
expect 0 splinemap diff full/live.splinemap office.splinemap

# --- a daemon that ends while the disk is full
rm full/*
mkdir temporary
TMPDIR=$PWD/temporary \
  splinemapd --config often.textproto --map full/live.splinemap "${listen[@]}" 2> daemon.log &
daemon=$!
await has '.saved_revision == .revision'
fill
head -c 1000000 office.lcmlog > part.lcmlog
lcm-logplayer -s 20 part.lcmlog > /dev/null
await has '.scans_mapped > 400'
kill "$daemon"
wait "$daemon" && fail "not all was saved, and yet the exit status is 0"
expect_text_in_log() { grep -q "$1" daemon.log || fail "no '$1' in: $(cat daemon.log)"; }
expect_text_in_log "full/live.splinemap: the disk is full"
expect_text_in_log "the map is in $PWD/temporary/live.rescue-.*.splinemap, with all commits"
expect 0 splinemap info temporary/live.rescue-*.splinemap
rm full/ballast
expect 0 splinemap info full/live.splinemap  # the last save, whole

# --- a read-only disk
mkdir fixed
mount -t tmpfs none fixed
cp office.splinemap copy_in_use.splinemap fixed
mount -o remount,ro fixed
expect 0 splinemap info fixed/office.splinemap
expect 1 splinemap info fixed/copy_in_use.splinemap
expect_text "copy it to another folder" err
expect 0 splinemap diff copy_in_use.splinemap office.splinemap
for map in office new; do
  expect 1 splinemapd --map fixed/$map.splinemap "${listen[@]}"
  expect_text "cannot open fixed/$map.splinemap for writing: Read-only file system" err
done
expect 1 splinemap build office.lcmlog fixed/x.splinemap
expect 1 splinemap simulate fixed/x.lcmlog
expect_text "cannot write fixed/x.lcmlog: Read-only file system" err

echo "files: all is well"
