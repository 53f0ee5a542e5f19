#!/usr/bin/env bash
# What each service costs with 1, 2, 4 … units: processor time per step of a unit, memory, what the recorder missed.
# usage: units.sh FOLDER_OF_PROGRAMS [SECONDS] [UNITS …]
set -euo pipefail

[ -x "${1:-}/weakgrid" ] || { echo "units.sh: '${1:-}': no folder of programs; usage: units.sh FOLDER_OF_PROGRAMS [SECONDS] [UNITS …]" >&2; exit 2; }
bin=$1 seconds=${2:-4}
shift $(($# < 2 ? $# : 2))
[ $# -gt 0 ] || set -- 1 2 4 8 16 32 64

. "$(dirname -- "${BASH_SOURCE[0]}")/step_of.sh"

work=$(mktemp -d)
pids=()
finish() {
  [ ${#pids[@]} -eq 0 ] || kill "${pids[@]}" 2> /dev/null || true
  wait
  rm -rf "$work"
}
trap finish EXIT

tick_us=$((1000000 / $(getconf CLK_TCK)))
cpu_us() { awk -v tick="$tick_us" '{ print ($14 + $15) * tick }' "/proc/$1/stat"; }
memory_mb() { awk '/^VmRSS/ { printf "%.0f", $2 / 1024 }' "/proc/$1/status"; }

printf '%5s %10s %9s | %-35s | %-31s | %s\n' '' '' '' 'µs of a processor per step' 'MB' 'recorder'
printf '%5s %10s %9s | %8s %10s %7s %8s | %5s %10s %7s %8s | %9s %7s\n' \
  units steps/s '× real' plant controller gateway recorder plant controller gateway recorder messages dropped
for units in "$@"; do
  printf '[unit]\ncount = %d\ndomain = 230\n[timing]\nperiod_us = 50\n[plant]\nsubsteps = 4\n' "$units" > "$work/settings.toml"
  pids=()
  for service in controller gateway plant; do
    "$bin/weakgrid-$service" --settings "$work/settings.toml" > "$work/$service.log" 2>&1 &
    pids+=($!)
  done
  "$bin/weakgrid-recorder" --domain 230 --output "$work/run.mcap" > "$work/recorder.log" 2>&1 &
  pids+=($!)
  # Until the last unit goes round; then a while of its own.
  until "$bin/weakgrid" status --domain 230 --unit "$units" > /dev/null; do sleep 0.2; done
  sleep 1
  before=() after=() memory=()
  first=$(step_of "$bin" 230 "$units") start=$(date +%s%N)
  for pid in "${pids[@]}"; do before+=("$(cpu_us "$pid")"); done
  sleep "$seconds"
  last=$(step_of "$bin" 230 "$units") elapsed_ns=$(($(date +%s%N) - start))
  for pid in "${pids[@]}"; do after+=("$(cpu_us "$pid")"); memory+=("$(memory_mb "$pid")"); done
  kill "${pids[@]}"
  wait "${pids[@]}" || true
  pids=()
  # Status 1: a writer's samples were lost on the way, as best effort may; what the recorder dropped is in the table.
  recorded=$({ "$bin/weakgrid" info "$work/run.mcap" --json || [ $? -eq 1 ]; } | awk -F'[:,]' '/^  "messages"/ { m = $2 } /^  "dropped"/ { d = $2 } END { print m, d }')
  awk -v units="$units" -v steps=$((last - first)) -v ns="$elapsed_ns" \
    -v cost="$((after[2] - before[2])) $((after[0] - before[0])) $((after[1] - before[1])) $((after[3] - before[3]))" \
    -v memory="${memory[2]} ${memory[0]} ${memory[1]} ${memory[3]}" -v recorded="$recorded" 'BEGIN {
      split(cost, c, " "); split(memory, m, " "); split(recorded, r, " ")
      all = steps * units
      printf "%5d %10.0f %9.2f | %8.1f %10.1f %7.1f %8.1f | %5d %10d %7d %8d | %9d %7d\n", units, all * 1e9 / ns,
        steps * 50e-6 * 1e9 / ns, c[1] / all, c[2] / all, c[3] / all, c[4] / all, m[1], m[2], m[3], m[4], r[1], r[2]
    }'
  rm -f "$work"/run.mcap
done
