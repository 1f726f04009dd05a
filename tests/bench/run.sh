#!/usr/bin/env bash
# Measures accuracy and speed against peers and writes build/bench/report.md.
set -euo pipefail

usage() {
  cat << HELP
usage: tests/bench/run.sh [--yes] [--quick] [--repetitions N]

  tests/bench/run.sh           everything, some 45 minutes on an idle machine; medians of 5 repetitions
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
rm -rf "$out"
mkdir -p "$out"
programs=build/bench/tests/bench
python=/usr/bin/python3  # the one that Debian's matplotlib is for

min_time=0.5
((${#quick[@]})) && min_time=0.005
subjects=(insertion/simulated_{360_beams_3.5_m,1440_beams_25_m} queries merging growth)
[[ -d ../shared/data ]] && subjects=(insertion/{intel,freiburg_079} "${subjects[@]}")
for subject in "${subjects[@]}"; do
  "$programs/speed/speed" "$subject" "${quick[@]}" --benchmark_repetitions="$repetitions" \
    --benchmark_min_time="$min_time" --benchmark_enable_random_interleaving=true \
    --benchmark_out="$out/speed_${subject//\//_}.json" --benchmark_out_format=json
done

"$programs/accuracy/accuracy" "${quick[@]}" --out "$out"
"$programs/surface/surface" "${quick[@]}" --out "$out"
"$programs/layers/layers" "${quick[@]}" --out "$out"
"$programs/bandwidth/bandwidth" "${quick[@]}" --json "$out/bandwidth.json" > "$out/bandwidth.txt"
deploy/own_bus.sh "$programs/serving/serving" "${quick[@]}" --json "$out/serving.json" > "$out/serving.txt"
"$programs/asking/asking_bench" "${quick[@]}" > "$out/asking.txt"
"$programs/align/align_bench" "${quick[@]}" --out "$out"
deploy/own_bus.sh "$programs/correcting/correcting" "${quick[@]}" > "$out/correcting.txt"
"$python" tests/bench/accuracy/plot.py "$out"
{
  "$python" tests/bench/report.py "$out"
  printf '\n## Following a map\n\n'
  sed 's/^/    /' "$out/serving.txt" "$out/bandwidth.txt"
  printf '\n## Asking a map\n\n'
  sed 's/^/    /' "$out/asking.txt"
  printf '\n## Correcting a map\n\n'
  grep -v '\[info\]\|\[warning\]' "$out/correcting.txt" | sed 's/^/    /'
} > build/bench/report.md
sed -n '/^## Machine/,/^## Scan/{/^## Scan/!p}' build/bench/report.md
echo "build/bench/report.md"
