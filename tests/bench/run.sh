#!/usr/bin/env bash
# Measures accuracy and speed against peers and writes build/bench/report.md.
set -euo pipefail

usage() {
  cat << HELP
usage: tests/bench/run.sh [--yes] [--quick] [--repetitions N]

  tests/bench/run.sh           everything, some minutes on an idle machine; medians of 5 repetitions
  tests/bench/run.sh --quick   a little of everything, to see that it works; its figures say nothing

Installs missing packages with apt-get (asks first on a terminal, unless --yes). Recorded drives are
read from ../shared/data; without it there are simulated ones only.
HELP
}

cd "$(dirname "$0")/../.."
assume_yes=no
quick=()
repetitions=5
while (($#)); do
  case $1 in
    --yes) assume_yes=yes; shift ;;
    --quick) quick=(--quick); repetitions=1; shift ;;
    --repetitions) repetitions=${2:-}; shift $(($# > 1 ? 2 : 1)) ;;
    -h | --help) usage; exit 0 ;;
    *) usage >&2; exit 2 ;;
  esac
done
[[ $repetitions =~ ^[1-9][0-9]*$ ]] || { usage >&2; exit 2; }

# shellcheck source=deploy/packages.sh
source deploy/packages.sh
install_packages "$assume_yes" "${BUILD_PACKAGES[@]}" "${TEST_PACKAGES[@]}" "${BENCH_PACKAGES[@]}"
[[ -f build/bench/build.ninja ]] || cmake --preset bench
cmake --build --preset bench

out=build/bench/results
mkdir -p "$out"
programs=build/bench/tests/bench

min_time=0.5
((${#quick[@]})) && min_time=0.005
"$programs/speed/speed" "${quick[@]}" --benchmark_repetitions="$repetitions" \
  --benchmark_min_time="$min_time" --benchmark_enable_random_interleaving=true \
  --benchmark_out="$out/speed.json" --benchmark_out_format=json

if [[ -x $programs/accuracy/accuracy ]]; then
  "$programs/accuracy/accuracy" "${quick[@]}" --out "$out"
  python3 tests/bench/accuracy/plot.py "$out"
fi
python3 tests/bench/report.py "$out" > build/bench/report.md
echo "build/bench/report.md"
