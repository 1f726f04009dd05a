#!/usr/bin/env bash
# Robots that are not who they seem, or have not what fits: what daemons say of them, and that no layer is
# harmed. A base station follows all of them, on a bus of their own.
if [[ -z ${LCM_DEFAULT_URL:-} || ${2:-} != inside ]]; then
  exec "$1/deploy/own_bus.sh" "$0" "$1" inside
fi
# shellcheck source=tests/integration/support.sh
source "$1/tests/integration/support.sh" "$1"

splinemap simulate office.lcmlog 2> /dev/null
"$top/tests/support/split_drive.py" office.lcmlog LASER 3 part_
for k in 1 2 3; do  # what robot-1, robot-2 and another robot-1 have mapped
  expect 0 splinemap build "part_$k.lcmlog" "map_$k.splinemap" --name "robot-$((k == 3 ? 1 : k))" \
    --scan LASER --pose POSE
done

declare -A daemon=()
start() {  # WHO NAME [FLAG..]: on WHO.splinemap
  local inputs=(--scan A --pose B)
  [[ $1 != base ]] || inputs=(--no-sensors)
  [[ ! -f $1.log ]] || mv "$1.log" "$1.old.log"
  splinemapd --map "$1.splinemap" --name "$2" "${inputs[@]}" "${@:3}" 2> "$1.log" &
  daemon[$1]=$!
  says "$1" "map $1.splinemap: layer"
}
stop() {  # WHO..
  local who
  for who; do kill "${daemon[$who]}"; done
  for who; do
    wait "${daemon[$who]}" || fail "$who ended with status $?: $(cat "$who.log")"
    unset "daemon[$who]"
  done
}
layer() { splinemap layers "$1.splinemap" --json | jq -r ".[] | select(.name == \"$2\") | $3"; }
says() { await grep -q -- "$2" "$1.log"; }  # WHO TEXT
# found NAME PROBLEM [NUMBER]: so many daemons of that name have said so in their status.
found() {
  [[ $(jq -r "select(.name == \"$1\" and .problems.$2 > 0) | .origin" said.jsonl | sort -u | wc -l) -ge ${3:-1} ]]
}
# has WHO LAYER HASH..: those and no other layers of this name, on its disk.
has() {
  [[ $(layer "$1" "$2" 'select(.tiles > 0) | .hash' | sort | xargs) == "$(printf '%s\n' "${@:3}" | sort | xargs)" ]]
}
harmless() {  # WHO..: files without damage, and robot-2's layer as it was
  local who
  for who; do
    expect 0 splinemap info "$who.splinemap"
    [[ $who == base || $who == second ]] || continue
    has "$who" robot-2 "$hash_2" || fail "robot-2 has changed: $(splinemap layers "$who.splinemap")"
  done
}

hash_1=$(layer map_1 robot-1 .hash)
hash_2=$(layer map_2 robot-2 .hash)
hash_3=$(layer map_3 robot-1 .hash)
printf 'service { save_interval_s: 0.5 }\n' > often.textproto
splinemap watch --json --timeout 20 > said.jsonl &
watch=$!
cp map_1.splinemap first.splinemap
cp map_2.splinemap second.splinemap
start base base --config often.textproto
start second robot-2 --follow 'robot-*'
start first robot-1 --follow 'robot-*'
await has base robot-1 "$hash_1"

# --- two robots of one name: both layers are in the map, and everybody says so
cp map_3.splinemap other.splinemap
start other robot-1
await found robot-1 shared_name 2
await found base shared_name
says other "there are two layers named robot-1"
says first "there are two layers named robot-1"
says base "there are two layers named robot-1"
await has base robot-1 "$hash_1" "$hash_3"
stop other
harmless base second other

# --- a cloned disk: one of the two goes on as another layer, with all that it had
stop first
cp first.splinemap clone.splinemap
start first robot-1 --follow 'robot-*' --config often.textproto
start clone robot-1 --follow 'robot-*' --config often.textproto
await grep -q "continues as another layer, origin" first.log clone.log
await found robot-1 shared_identity
for who in base first clone; do await has $who robot-1 "$hash_1" "$hash_1" "$hash_3"; done
stop clone first
harmless base second first clone
rm first.splinemap clone.splinemap

# --- a replaced computer: the same name and an empty file; the old layer stays
start new robot-1 --follow 'robot-*'
says new "there are two layers named robot-1"
await has base robot-1 "$hash_1" "$hash_1" "$hash_3"
stop new
harmless base second new

# --- yesterday's file, while the base station has today's layer
cp second.splinemap yesterday.splinemap
stop second
start second robot-2
stop second
start second robot-2
sleep 3.5  # a start counts after two seconds
kill -KILL "${daemon[second]}"
wait "${daemon[second]}" 2> /dev/null || true
cp yesterday.splinemap second.splinemap
rm -f second.splinemap-*
start second robot-2
says second "is an older copy. It continues as session"
await found robot-2 shared_identity

# --- another knot interval, other clamps
start wide robot-8 --config <(echo 'method { clamp_max: 20 }') --follow 'robot-*'
says base "the layer of robot-8: its control points are clamped to -64 .. 20, and to -64 .. 64 here"
start coarse robot-7 --config <(echo 'method { knot_interval_m: 0.1 }') --follow 'robot-*'
for who in base coarse wide; do says "$who" "the layer of robot-"; done
says base "the map leaves out the layer of robot-7: its knot interval is 0.1 m, and 0.05 m here"
says wide "the layer of robot-2: its control points are clamped to -64 .. 64, and to -64 .. 20 here"
for name in base robot-7 robot-8; do await found $name refused_layer; done
expect 0 splinemap layers --live --json
[[ $(jq -c '[(.[] | select(.daemon == "base").refused | length),
  (.[] | select(.daemon == "robot-7").layers | length)]' out) == '[2,1]' ]] || fail "layers: $(cat out)"
expect 1 splinemap snapshot fleet.splinemap --robot 'robot-[278]' --timeout 5
expect_text "left out: robot-" err
stop "${!daemon[@]}"
harmless base second coarse wide
for who in coarse wide; do
  [[ $(splinemap layers $who.splinemap --json | jq length) == 1 ]] || fail "$who took what does not fit"
done
kill "$watch"
echo "identity: $(splinemap layers base.splinemap | wc -l) lines about layers in the base station's file"
