#!/usr/bin/env bash
# What plant and controller do per step besides computing: heap allocations, locks and system calls of each thread.
set -euo pipefail

usage() {
  cat <<'USAGE'
usage: per_step.sh BUILD_DIR [SETTINGS]

Runs weakgrid-plant and weakgrid-controller of BUILD_DIR in lockstep. Per thread and step:
  allocations, locks   by libcount_calls.so, as the difference between a long and a short run; "own" are the locks
                       that the program's code takes and not a library's
  system calls         by strace, over some thousand steps in the middle of a run

exit code: 0 done, 2 bad usage, 3 a program is missing or a service has not come to its end
USAGE
}

fail() {
  echo "per_step.sh: $2" >&2
  exit "$1"
}

case "${1:-}" in
  -h | --help) usage; exit 0 ;;
  '' | -*) usage >&2; exit 2 ;;
esac
bin=$1/bin
calls=$1/tests/bench/libcount_calls.so
[ -x "$bin/weakgrid-plant" ] && [ -e "$calls" ] || fail 2 "$1 is no folder of a build with tests"
command -v strace > /dev/null || fail 3 "strace is not on the PATH: apt-get install strace"
settings=()
[ $# -lt 2 ] || settings=(--settings "$2")
domain=229
scratch=$(mktemp -d)
pids=()
stop() {
  [ ${#pids[@]} -eq 0 ] || kill "${pids[@]}" 2> /dev/null || true
  wait
  pids=()
}
trap 'stop; rm -rf "$scratch"' EXIT

# start STEPS [ENVIRONMENT]: both services up to that step.
start() {
  for service in controller plant; do
    local until=()
    [ $service = controller ] || until=(--until "$1")
    env "${@:2}" "$bin/weakgrid-$service" --domain $domain "${settings[@]}" "${until[@]}" 2> "$scratch/$service.$1" &
    pids+=($!)
  done
}

# step: of the plant, as it says itself.
step() {
  "$bin/weakgrid" status --domain $domain --wait 0.5 --json > "$scratch/status" || true
  grep -A3 '"service": "plant"' -B6 "$scratch/status" | sed -n 's/.*"step": \([0-9]*\).*/\1/p' | head -1
}

come_to() {
  local n
  for n in $(seq 60); do
    [ "$(step)" != "$1" ] || return 0
    sleep 0.5
  done
  fail 3 "the plant has not come to step $1"
}

echo "allocations, locks and own locks per step, of threads that do any"
short=20000
long=120000
for steps in $short $long; do
  start $steps LD_PRELOAD="$calls"
  come_to $steps
  stop
done
for service in plant controller; do
  # Threads in the order of their first call: the same in both runs.
  paste <(grep '^calls:' "$scratch/$service.$short") <(grep '^calls:' "$scratch/$service.$long") |
    awk -v name=$service -v n=$((long - short)) '{
      a = ($14 - $5) / n; l = ($16 - $7) / n; o = ($18 - $9) / n
      if (a >= 0.001 || l >= 0.001) printf "  %-12s thread %-3d %8.3f %8.3f %8.3f\n", name, NR, a, l, o }'
done

echo "system calls per step"
start 1000000000
sleep 3
declare -A pid=([controller]=${pids[0]} [plant]=${pids[1]})
for service in plant controller; do
  timeout -s INT 3 strace -q -f -o "$scratch/trace" -p "${pid[$service]}" 2> /dev/null || true
  # The loop is the thread that sends most; each step it sends once.
  awk -v name=$service '
    $2 ~ /^[a-z_0-9]+\(/ || $2 == "<..." {
      if ($2 == "<...") next
      call = $2; sub(/\(.*/, "", call); ++calls[$1 " " call]; threads[$1]
      if (call ~ /^send/) { ++sends[$1]; if (sends[$1] > steps) steps = sends[$1] }
    }
    END {
      for (key in calls) if (calls[key] / steps >= 0.001) {
        split(key, of, " ")
        printf "  %-12s thread %-8d %-18s %8.3f\n", name, of[1], of[2], calls[key] / steps
      }
      printf "  %-12s %d steps seen\n", name, steps
    }' "$scratch/trace" | sort -k3,3n -k5,5nr
done
stop
