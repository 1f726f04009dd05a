#!/usr/bin/env bash
# Checks all documents (*.md) of the project. Runs every command in their blocks marked sh, each
# document in a folder of its own, beside a base station that has the layers of three robots. A
# block marked "sh REASON" is not run; the reasons are those of `not_run` below.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

declare -A not_run=([builds]=0 [fleet]=0 [keys]=0 [systemd]=0 [takes-minutes]=0 [opens-a-window]=0 [viewer]=0)
cd "$top"
mapfile -t documents < <(find . -name '*.md' -not -path './build/*' -not -path './.*' \
  -not -path '*/node_modules/*' |
  sed 's/^..//' | sort)
((${#documents[@]} > 35)) || fail "only ${#documents[@]} documents found"

# --- What documents say of each other, of sources and of tests.

long=$(awk '!/^\|/ && length > 100 { print FILENAME ":" FNR; exit }' "${documents[@]}")
[[ -z $long ]] || fail "a line of more than 100 characters: $long"
(($(wc -c < README.md) <= 7000)) || fail "README.md has more than 7,000 bytes"
for folder in {lib,services,clients}/ {lib,services,clients}/*/; do
  [[ -e $folder/README.md ]] || fail "no README.md in $folder"
done

# The anchors of a document's headings.
anchors_of() {
  grep '^#' "$1" | sed 's/^#* //' | tr '[:upper:]' '[:lower:]' | sed 's/[^a-z0-9 _-]//g; s/ /-/g'
}
links=0
while read -r document link; do
  target=${link%%#*}
  path=$document
  [[ -z $target ]] || path=$(dirname "$document")/$target
  [[ -e $path ]] || fail "$document links to $link, which is not there"
  [[ $link != *#* ]] || grep -qxF -- "${link#*#}" <(anchors_of "$path") ||
    fail "$document links to $link, and there is no such heading"
  links=$((links + 1))
done < <(awk '/^```/ { code = !code; next }
  !code { while (match($0, /\]\([^)]+\)/)) {
    link = substr($0, RSTART + 2, RLENGTH - 3)
    $0 = substr($0, RSTART + RLENGTH)
    if (link !~ /:\/\//) print FILENAME, link } }' "${documents[@]}")
((links > 50)) || fail "only $links links found"
echo "readme: $links links lead somewhere"

# What is quoted from a source file is in it, line by line.
quoted=0
while IFS=$'\t' read -r file line; do
  grep -qxF -- "$line" <(sed 's/^ *//' "$file") || fail "a document quotes $file: $line"
  quoted=$((quoted + 1))
done < <(awk '/^<!-- in / { file = $3; next }
  /^```/ { inside = ($0 == "```cpp" && file != ""); if (!inside) file = ""; next }
  inside { sub(/^ */, ""); print file "\t" $0 }' "${documents[@]}")
((quoted > 10)) || fail "only $quoted quoted lines found"
echo "readme: $quoted lines are quoted from sources"

# The example in bytes is the one that the follower is tested with.
documented=$(awk '/^```/ { code = !code; next } code' lcmtypes/FOLLOWING.md |
  grep -oE '^[0-9a-f]{2,}( [0-9a-f]{2,})*' | tr -dc '0-9a-f')
parts=0
while read -r part; do
  [[ $documented == *"$part"* ]] || grep -q " $part |" lcmtypes/FOLLOWING.md ||
    fail "FOLLOWING.md has other bytes than the test: $part"
  parts=$((parts + 1))
done < <(sed -n '/TheDocumentedMessagesAreFollowed/,/^}/p' tests/unit/replication_test.cc |
  grep -oE '"[0-9a-f]+"' | tr -d '"')
((parts > 10)) || fail "only $parts lines of bytes found"
echo "readme: the bytes of the example are those of the tests"

# The tests that tests/README.md names are there.
cat tests/{*,*/*}/*.cc | grep -oE '^TEST(_F|_P)?\([A-Za-z]*, [A-Za-z]*\)' > "$work/tests.txt"
# shellcheck disable=SC2016  # the quotes are Markdown's
while read -r name; do
  suite=${name%.*}
  test=${name#*.}
  test=${test//\*/[A-Za-z]*}
  grep -qE "\(${suite:-[A-Za-z]*}, $test\)" "$work/tests.txt" || fail "tests/README.md names $name"
done < <(grep -oE '`[A-Za-z]*\.[A-Z*][A-Za-z]*`|`[A-Za-z]*\.\*`' tests/README.md | tr -d '`')
echo "readme: the tests of the table exist"

# The runbook has an entry for each name and subject that the daemon reports.
{
  sed -n 's/.*return "\([a-z_]*\)";/\1/p' lib/pipeline/notice.cc
  sed -n 's/^ *return {"\([a-z_]*\)".*/\1/p; s/^ *"\([a-z_]*\)",$/\1/p' lib/sensing/drop_counts.cc
  cat services/splinemapd/*.cc lib/pipeline/*.cc | tr '\n' ' ' |
    grep -oE '(subject = |notices_.Add\((true|false), )(fmt::format\()?"[a-z]+( [a-z]+)*' | sed 's/.*"//'
} | grep -vx unknown | sort -u > "$work/reported.txt"
while read -r name; do
  grep -qF "**\`$name\`**" deploy/RUNBOOK.md || fail "deploy/RUNBOOK.md has no entry for $name"
done < "$work/reported.txt"
(($(wc -l < "$work/reported.txt") > 55)) || fail "too few names: $(cat "$work/reported.txt")"
# And for each error that the daemon itself logs.
while read -r text; do
  grep -qF "**${text//{*/..}" deploy/RUNBOOK.md || fail "deploy/RUNBOOK.md has no entry for $text"
done < <(grep -ohE 'spdlog::(error|warn)\("[^{"]+[{"]' services/splinemapd/*.cc | sed 's/.*("//')
echo "readme: the runbook has $(wc -l < "$work/reported.txt") names"

# --- The commands.

# What they name.
mkdir "$work/fixtures"
cd "$work/fixtures"
cat > short.world << 'EOF'
wall { x0_m: 5 y0_m: -5 x1_m: 5 y1_m: 9 } waypoint { x_m: 0 } waypoint { x_m: 3 y_m: 6.5 }
EOF
expect 0 splinemap simulate short.world drive.lcmlog
for map in drive other lab; do expect 0 splinemap build drive.lcmlog "$map.splinemap"; done
for robot in robot-1 robot-2 robot-3; do
  expect 0 splinemap build drive.lcmlog "$robot.splinemap" --name "$robot"
done
expect 0 splinemap merge robot-{1,2,3}.splinemap --out fleet.splinemap
cp "$top/deploy/config/splinemapd.textproto" .
printf '1,2\n3,4\n' > path.csv
[[ ! -d $shared_data ]] || ln -s "$shared_data"/carmen/*.gz "$shared_data"/lcm/*.lcmlog .
cd "$work"

cp fixtures/fleet.splinemap base.splinemap
splinemapd --no-sensors --name base --map base.splinemap 2> base.log &
base=$!
await splinemap watch --once --timeout 2
# For the blocks marked "sh viewer".
if command -v splinemap-viewer > /dev/null; then
  splinemap-viewer --allow-commands 2> viewer.log &
  await curl -s localhost:8086/healthz
fi

run() {
  local command=$1 log flags chosen
  case $command in
    "deploy/demo.sh "*)  # the same flags, offline; the demo is tried by hand
      read -ra flags <<< "${command#* }"
      log=${flags[0]}
      [[ -e $log ]] || { echo "skipped, the shared data folder is not there: $command"; return; }
      if [[ $log == *.gz ]]; then
        expect 0 splinemap import-carmen "$log" demo.lcmlog --force
        log=demo.lcmlog
      fi
      expect 0 splinemap doctor "$log" --json "${flags[@]:1}"
      mapfile -t chosen < <(jq -r '.chosen_flags[]' "$work/out")
      expect 0 splinemap build "$log" demo.splinemap --force "${flags[@]:1}" "${chosen[@]}"
      ;;
    "deploy/fleet/"*) expect 0 bash -c "$top/$command" ;;
    *"intel-corrected.log.gz "* | *" intel.lcmlog "*)
      [[ ! -e intel-corrected.log.gz ]] || expect 0 bash -c "$command"
      ;;
    "splinemapd "*"&")  # until the kill that follows
      eval "exec ${command%&}" 2> daemon.log &
      daemon=$!
      await grep -q listening daemon.log
      ;;
    "kill -INT %1 && wait")
      sleep 0.5
      kill -INT "$daemon"
      wait "$daemon" || fail "the daemon failed: $(cat daemon.log)"
      ;;
    "splinemapd "*"-config") expect 0 bash -c "$command" ;;
    "splinemapd "*) expect 0 timeout --preserve-status --signal=INT 1 bash -c "exec $command" ;;
    "splinemap doctor --live --seconds "*)  # nobody drives here
      expect 1 splinemap doctor --live --seconds 1
      ;;
    "splinemap watch" | "splinemap watch --json" | "splinemap bridge "*)  # run until they are ended
      expect 124 timeout 1 bash -c "exec $command"
      ;;
    "splinemap-viewer "*) expect 124 timeout 1 bash -c "exec $command --port 0" ;;
    "curl "*) expect 0 bash -c "curl --silent --fail ${command#curl }" ;;
    "splinemap-planner "*)
      command -v splinemap-planner > /dev/null ||
        { echo "skipped, OMPL is not there: $command"; return; }
      expect 124 timeout 1 bash -c "exec $command"
      ;;
    *) expect 0 bash -c "$command" ;;
  esac
}

# The lines of the blocks, each behind its reason, or "run"; without comments, in whole lines.
commands_of() {
  awk '/^```/ { inside = /^```sh/; reason = NF > 1 ? $2 : "run"; next }
    inside { sub(/ +#.*/, ""); sub(/^#.*/, ""); sub(/ +$/, "") }
    inside && /\\$/ { line = line substr($0, 1, length($0) - 1); next }
    inside && (line $0) != "" { print reason "\t" line $0; line = "" }' "$top/$1"
}

ran=0
for document in "${documents[@]}"; do
  folder=$work/${document//\//_}
  cp -r "$work/fixtures" "$folder"
  cd "$folder"
  while IFS=$'\t' read -r reason command <&3; do
    [[ $reason != viewer ]] || ! command -v splinemap-viewer > /dev/null || reason=run
    if [[ $reason != run ]]; then
      [[ -n ${not_run[$reason]:-} ]] || fail "$document: no reason not to run a command: $reason"
      not_run[$reason]=$((${not_run[$reason]} + 1))
      continue
    fi
    # A command makes what others find there.
    [[ $command != "splinemap build "*" drive.splinemap"* ]] || rm -f drive.splinemap
    begin=${EPOCHREALTIME/./}
    run "$command"
    ran=$((ran + 1))
    (((${EPOCHREALTIME/./} - begin) < 5000000)) || echo "readme: more than 5 s: $command"
  done 3< <(commands_of "$document")
  cd "$work"
done
((ran > 30)) || fail "only $ran commands found"
kill "$base"
wait "$base" || fail "the base station failed: $(cat base.log)"
echo "readme: $ran commands ran"
for reason in "${!not_run[@]}"; do echo "readme: not run, $reason: ${not_run[$reason]}"; done
