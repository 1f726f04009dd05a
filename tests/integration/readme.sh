#!/usr/bin/env bash
# Runs every command of the README's examples, but those that fetch, install or build.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

# What the examples name.
cat > short.world << 'EOF'
wall { x0_m: 5 y0_m: -5 x1_m: 5 y1_m: 9 } waypoint { x_m: 0 } waypoint { x_m: 3 y_m: 6.5 }
EOF
splinemap simulate short.world drive.lcmlog 2> /dev/null
splinemap build drive.lcmlog --out other.splinemap 2> /dev/null
splinemap build drive.lcmlog --out robot-2.splinemap --name robot-2 2> /dev/null
cp "$top/deploy/config/splinemapd.textproto" .
printf '1,2\n3,4\n' > path.csv
[[ ! -d $shared_data ]] || ln -s "$shared_data"/carmen/*.gz "$shared_data"/lcm/*.lcmlog .

# The lines of the blocks marked sh.
mapfile -t commands < <(awk '/^```/ { inside = ($0 == "```sh"); next } inside' "$top/README.md" |
  sed 's/ *#.*//; /^$/d')
((${#commands[@]} > 15)) || fail "only ${#commands[@]} commands found"

ran=0
for command in "${commands[@]}"; do
  read -ra words <<< "$command"
  case $command in
    *deploy/lcm-spy.sh*) continue ;;  # lcm_spy.sh tries it
    "git clone"* | deploy/demo.sh | tests/run.sh) continue ;;  # run by whoever reads this
    "deploy/demo.sh "*)  # the same flags, offline; the demo is tried by hand
      log=${words[1]}
      [[ -e $log ]] || { echo "skipped, the shared data folder is not there: $command"; continue; }
      if [[ $log == *.gz ]]; then
        expect 0 splinemap import-carmen "$log" "$log.lcmlog"
        log=$log.lcmlog
      fi
      expect 0 splinemap doctor "$log" --json "${words[@]:2}"
      mapfile -t chosen < <(jq -r '.chosen_flags[]' out)
      expect 0 splinemap build "$log" --out recorded.splinemap --force "${words[@]:2}" "${chosen[@]}"
      ;;
    "splinemap import-carmen "* | *" intel.lcmlog "*)
      [[ -e intel-corrected.log.gz ]] || continue
      expect 0 "${words[@]}"
      ;;
    "splinemapd "*"&")  # the block on replay
      splinemapd "${words[@]:1:${#words[@]}-2}" 2> daemon.log &
      daemon=$!
      await splinemap watch --once --timeout 2
      ;;
    "kill -INT %1 && wait")
      sleep 1
      kill -INT "$daemon"
      wait "$daemon" || fail "the daemon failed: $(cat daemon.log)"
      ;;
    "splinemapd "*"-config") expect 0 "${words[@]}" ;;
    "splinemapd "*) expect 0 timeout --preserve-status --signal=INT 2 "${words[@]}" ;;
    # Nobody is there: they say so.
    "splinemap snapshot "*)
      splinemapd --scan LASER --pose POSE --map served.splinemap 2> daemon.log &
      daemon=$!
      expect 0 "${words[@]}"
      kill -INT "$daemon"
      wait "$daemon" || fail "the daemon failed: $(cat daemon.log)"
      ;;
    "splinemap-planner "*)
      command -v splinemap-planner > /dev/null || { echo "skipped, OMPL is not there: $command"; continue; }
      expect 124 timeout 2 "${words[@]}"
      ;;
    "splinemap bridge "*) expect 124 timeout 2 "${words[@]}" ;;
    "splinemap watch") expect 1 timeout 10 splinemap watch ;;
    "splinemap doctor --live "*) expect 1 splinemap doctor --live --seconds 1 ;;
    *) expect 0 "${words[@]}" ;;
  esac
  ran=$((ran + 1))
done
echo "readme: $ran commands ran"

# What is quoted from a source file is in it, line by line.
quoted=0
while IFS=$'\t' read -r file line; do
  grep -qxF -- "$line" <(sed 's/^ *//' "$top/$file") || fail "not in $file: $line"
  quoted=$((quoted + 1))
done < <(awk '/^<!-- in / { file = $3; next } /^```/ { inside = ($0 == "```cpp" && file != ""); if (!inside) file = ""; next }
  inside { sub(/^ */, ""); print file "\t" $0 }' "$top/README.md")
((quoted > 5)) || fail "only $quoted quoted lines found"
echo "readme: $quoted lines are quoted from sources"

# The tests that tests/README.md names are there.
# shellcheck disable=SC2016  # the quotes are Markdown's
while read -r name; do
  suite=${name%.*}
  test=${name#*.}
  test=${test//\*/[A-Za-z]*}
  grep -qE "^TEST(_F|_P)?\(${suite:-[A-Za-z]*}, $test\)" "$top"/tests/{*,*/*}/*.cc || fail "tests/README.md names $name"
done < <(grep -oE '`[A-Za-z]*\.[A-Z*][A-Za-z]*`|`[A-Za-z]*\.\*`' "$top/tests/README.md" | tr -d '`')
echo "readme: the tests of the table exist"
