# shellcheck shell=bash
# What the integration scripts share. They get the top of the checkout as $1 and the programs on PATH.
set -euo pipefail
top=$1
shared_data=$top/../shared/data
export top shared_data
work=$(mktemp -d)
# Ends what the script started, by id.
clean_up() {
  local job
  for job in $(jobs -p); do kill "$job" 2> /dev/null || true; done
  wait 2> /dev/null || true  # they may be writing
  rm -rf "$work"
}
trap clean_up EXIT
cd "$work"

# fail WHAT: ends the script; what its programs said last is printed too.
fail() {
  echo "FAILED: $*" >&2
  local log
  for log in "$work"/*.log; do
    [[ -f $log ]] || continue
    echo "-- ${log##*/}" >&2
    grep -m 1 -A 5 -E '^(panic|fatal error):' "$log" >&2 || true
    tail -n 10 "$log" >&2
  done
  exit 1
}

# expect STATUS COMMAND..: the command ends with that status; its output is in $work/out and $work/err.
expect() {
  local wanted=$1 status=0
  shift
  "$@" > "$work/out" 2> "$work/err" || status=$?
  ((status == wanted)) || fail "status $status in place of $wanted: $* : $(cat "$work/out" "$work/err")"
}

# expect_text TEXT FILE: the file of the last expect, out or err, has the text.
expect_text() { grep -qF -- "$1" "$work/$2" || fail "no '$1' in: $(cat "$work/$2")"; }

# await COMMAND..: until it succeeds, at most 20 s.
await() {
  for _ in {1..100}; do
    if "$@" > "$work/awaited" 2>&1; then return 0; fi
    sleep 0.2
  done
  fail "did not come true in 20 s: $*: $(tail -n 10 "$work/awaited")"
}

# start_drive LOG SPEED: plays the log again and again, until end_drive.
start_drive() {
  (
    trap 'kill "$player"; exit' TERM
    while true; do
      lcm-logplayer -s "$2" "$1" > /dev/null 2>&1 &
      player=$!
      wait "$player"
    done
  ) &
  driving=$!
}
end_drive() {
  kill "$driving"
  wait "$driving" 2> /dev/null || true
}

# Keeps what daemons publish for status_of, until end_watching.
start_watching() {
  splinemap watch --json > status.jsonl 2> /dev/null &
  watching=$!
}
end_watching() {
  kill "$watching"
  wait "$watching" 2> /dev/null || true
}
# status_of ROBOT FIELD: of its last status; 0 where there is none.
status_of() { grep -a "\"$1\"" status.jsonl | tail -n 1 | jq "$2" 2> /dev/null || echo 0; }
