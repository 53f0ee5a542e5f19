#!/usr/bin/env bash
# The digest that a probe prints is that of `weakgrid simulate` for the same scenario.
# usage: same_bits.sh PROBE WEAKGRID SCENARIO
set -euo pipefail
probe=$("$1")
simulated=$("$2" simulate --json "$3" | sed -n 's/.*"modulation_digest": "\([0-9a-f]*\)".*/\1/p')
echo "probe     $probe"
echo "simulate  $simulated"
[ ${#probe} -eq 64 ] && [ "$probe" = "$simulated" ]
