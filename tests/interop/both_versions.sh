#!/usr/bin/env bash
# Services built with one Fast DDS and with another run one loop over UDP, with default settings: who is built with which
# in turn. The loop takes its setpoints and does what `weakgrid simulate` computes to the bit, by the modulation's digest;
# what either's recorder has kept of it, both verify.
# usage: both_versions.sh FOLDER_OF_PROGRAMS OTHER_ROOT OTHER_FOLDER_OF_PROGRAMS
#   OTHER_ROOT   a Debian in a folder, with /tmp in common; OTHER_FOLDER_OF_PROGRAMS is in there. Needs root: chroot
# exit code: 0 held, 1 did not, 2 bad usage, 3 no DDS domain is free
set -euo pipefail
[ $# -eq 3 ] && [ -x "$1/weakgrid" ] && [ -x "$2$3/weakgrid" ] || { sed -n '/^# usage/,/^# exit/p' "$0" >&2; exit 2; }
bin=$1 other_root=$2 other_bin=$3

work=$(mktemp -d /tmp/weakgrid-both-versions-XXXXXX)
trap 'rm -rf "$work"' EXIT
[ -d "$other_root$work" ] || { echo "both_versions.sh: /tmp is not in common with $other_root" >&2; exit 2; }

fail() {
  echo "both_versions.sh: $*" >&2
  exit 1
}

# A DDS domain that no other test on this machine has: tests/support/test_domain.hpp.
free_domain() {
  local lock
  for domain in {215..229}; do
    lock=/tmp/weakgrid-test-domain-$domain.lock
    { [ -e "$lock" ] || (umask 0; : > "$lock"); } 2> /dev/null || true
    if { exec 8< "$lock"; } 2> /dev/null && flock --nonblock 8; then return; fi
  done
  echo "both_versions.sh: no DDS domain is free for a test" >&2
  exit 3
}
free_domain

other() { chroot "$other_root" "$other_bin/$1" "${@:2}"; }
digest() { sed -n 's/.*"modulation_digest": "\([0-9a-f]*\)".*/\1/p'; }
libraries() { ldd "$1" | sed -n 's/^[[:space:]]*\(libfast\(rtps\|dds\)\.so[^ ]*\).*/\1/p'; }

here_is=$(libraries "$bin/weakgrid-plant")
there_is=$(chroot "$other_root" ldd "$other_bin/weakgrid-plant" | sed -n 's/^[[:space:]]*\(libfast\(rtps\|dds\)\.so[^ ]*\).*/\1/p')
[ "$here_is" != "$there_is" ] || fail "both are built with $here_is"

# `weakgrid run` starts the programs that stand beside it: some are this build's, the others call the other's.
cp "$bin/weakgrid" "$work/weakgrid"
scenario=$work/scenario.toml
cp "$(dirname -- "$(readlink -f -- "$0")")/../../deploy/settings/paper-weak.toml" "$scenario"
expected=$("$bin/weakgrid" simulate --json "$scenario" | digest)
[ ${#expected} -eq 64 ] || fail "weakgrid simulate tells no digest"
[ "$(other weakgrid simulate --json "$scenario" | digest)" = "$expected" ] || fail "the two do not simulate the same"

# plays WHO PROGRAM ...: these are the other build's.
plays() {
  local who=$1 service verdicts
  shift
  for service in plant controller gateway recorder; do
    rm -f "$work/weakgrid-$service"
    if [[ " $* " = *" $service "* ]]; then
      printf '#!/bin/sh\nexec chroot "%s" "%s/weakgrid-%s" "$@"\n' "$other_root" "$other_bin" "$service" > "$work/weakgrid-$service"
      chmod +x "$work/weakgrid-$service"
    else
      cp "$bin/weakgrid-$service" "$work/weakgrid-$service"
    fi
  done
  rm -f "$work/run.mcap"
  "$work/weakgrid" run "$scenario" --json --domain "$domain" --record "$work/run.mcap" > "$work/report.json" ||
    fail "$who: the run failed: $(cat "$work/report.json")"
  [ "$(digest < "$work/report.json")" = "$expected" ] || fail "$who: not the modulations that are computed: $(cat "$work/report.json")"
  verdicts=$(grep -c '"verdict": "accepted"' "$work/report.json") || true
  [ "$verdicts" -eq 2 ] || fail "$who: $verdicts of 2 setpoints accepted: $(cat "$work/report.json")"
  "$bin/weakgrid" verify "$work/run.mcap" > "$work/verify.log" || fail "$who: $here_is refuses the recording: $(cat "$work/verify.log")"
  other weakgrid verify "$work/run.mcap" > "$work/verify.log" || fail "$who: $there_is refuses the recording: $(cat "$work/verify.log")"
  echo "both_versions.sh: $who: 2 setpoints accepted, digest ${expected:0:16}…; $(tail -n 1 "$work/verify.log")"
}

plays "controller and recorder of $there_is, plant and gateway of $here_is" controller recorder
plays "plant and gateway of $there_is, controller and recorder of $here_is" plant gateway
