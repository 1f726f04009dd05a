#!/usr/bin/env bash
# figures.sh TOP LOG: what the viewer costs, and how soon a scan is a pixel. LOG is an LCM log of LASER
# and POSE, as import-carmen makes them. By hand, on an idle machine; the programs on the PATH.
if [[ ${3:-} != inside ]]; then
  npm ci --prefix "$1/tests/browser" --no-audit --no-fund --loglevel=error || exit 1
  exec "$1/deploy/own_bus.sh" "$0" "$1" "$(realpath "$2")" inside
fi
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
ln -s "$2" drive.lcmlog

# A map of 10^5 tiles: that of the drive beside itself, again and again.
splinemap build drive.lcmlog one.splinemap --scan LASER --pose POSE --name one 2> /dev/null
metres=51.2  # 1,024 knots
for n in {1..9}; do
  place=("$metres" 0)
  ((n % 2)) || place=(0 "$metres")
  splinemap layer place one.splinemap one "${place[@]}" 0 --out other.splinemap --force 2> /dev/null
  splinemap flatten other.splinemap flat.splinemap --name other --force > /dev/null 2>&1
  splinemap merge one.splinemap flat.splinemap --out both.splinemap --force > /dev/null 2>&1
  splinemap flatten both.splinemap one.splinemap --name one --force > /dev/null 2>&1
  ((n % 2)) || metres=$(jq -n "2 * $metres")
done
node "$1/tests/browser/figures.mjs"
