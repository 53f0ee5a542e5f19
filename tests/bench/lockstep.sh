#!/usr/bin/env bash
# How fast plant and controller go in lockstep at 50 µs steps, as a multiple of real time: apart over UDP, the same with
# DDS Security, apart with shared memory, in one process; as started, and first in line on one processor (needs root). Medians of rounds in turn.
# usage: lockstep.sh FOLDER_OF_PROGRAMS [SECONDS] [ROUNDS]
set -euo pipefail

[ -x "${1:-}/weakgrid" ] || { echo "lockstep.sh: '${1:-}': no folder of programs; usage: lockstep.sh FOLDER_OF_PROGRAMS [SECONDS] [ROUNDS]" >&2; exit 2; }
bin=$1 seconds=${2:-3} rounds=${3:-3}
domain=230
. "$(dirname -- "${BASH_SOURCE[0]}")/step_of.sh"

work=$(mktemp -d)
pids=()
finish() {
  [ ${#pids[@]} -eq 0 ] || kill "${pids[@]}" 2> /dev/null || true
  wait
  rm -rf "$work"
}
trap finish EXIT

"$(dirname -- "${BASH_SOURCE[0]}")/../../deploy/security/make" "$work/keys" --domain $domain > /dev/null

# rate udp|secured|data_sharing PRIORITY PROGRAM …
rate() {
  local loop=$1 priority=$2 security= first last start elapsed
  [ "$loop" != secured ] || { loop=udp security=$work/keys; }
  shift 2
  cat > "$work/settings.toml" <<T
[unit]
domain = $domain
[timing]
period_us = 50
[grid]
reactance = 0.3
[plant]
substeps = 4
[dds]
loop = "$loop"
security = "$security"
[realtime]
priority = $priority
cpu = $([ "$priority" -gt 0 ] && echo 0 || echo -1)
dma_latency = $([ "$priority" -gt 0 ] && echo true || echo false)
T
  pids=()
  for program in "$@"; do
    "$bin/weakgrid-$program" --settings "$work/settings.toml" > "$work/$program.log" 2>&1 &
    pids+=($!)
  done
  until first=$(step_of "$bin" $domain 1 --settings "$work/settings.toml") && [ -n "$first" ]; do sleep 0.2; done
  start=$(date +%s%N)
  sleep "$seconds"
  last=$(step_of "$bin" $domain 1 --settings "$work/settings.toml") elapsed=$(($(date +%s%N) - start))
  kill "${pids[@]}"
  wait "${pids[@]}" || true
  pids=()
  awk -v steps=$((last - first)) -v ns="$elapsed" 'BEGIN { printf "%.3f\n", steps * 50000 / ns }'
}

for ((n = 0; n < rounds; ++n)); do
  for priority in 0 50; do
    rate udp $priority controller plant >> "$work/udp_$priority"
    rate secured $priority controller plant >> "$work/secured_$priority"
    rate data_sharing $priority controller plant >> "$work/data_sharing_$priority"
    rate udp $priority unit >> "$work/one_process_$priority"
  done
done
printf '%-14s %12s %24s\n' lockstep 'as started' 'FIFO 50, one processor'
for mode in udp secured data_sharing one_process; do
  printf '%-14s' $mode
  for priority in 0 50; do
    sort -n "$work/${mode}_$priority" | awk '{ v[NR] = $1 } END { printf " %12.2f x", v[int((NR + 1) / 2)] }'
  done
  printf '\n'
done
