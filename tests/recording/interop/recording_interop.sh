#!/usr/bin/env bash
# What the real programs record is read by the official MCAP and IDL readers, and is what weakgrid export says it is.
# usage: recording_interop.sh PROGRAMS BUILD_DIR SCENARIO [RECORDING...]
#   PROGRAMS   folder of weakgrid, weakgrid-plant, ...
#   SCENARIO   settings file that weakgrid run plays
#   RECORDING  check these instead of recordings made for the test
# exit code: 0 all agree, 1 not, 3 packages could not be installed or no DDS domain is free
set -euo pipefail
here=$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")
# shellcheck source=tests/support/npm_packages.sh
source "$here/../../support/npm_packages.sh"
# shellcheck source=tests/support/free_domain.sh
source "$here/../../support/free_domain.sh"
into=$2/interop_mcap
install_packages "$here" "$into"
exec 9>&-
mkdir -p "$into/recordings"
cp "$here/recording_interop.mjs" "$here/decompress.mjs" "$into/recordings/"

free_domain
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
node "$into/recordings/recording_interop.mjs" "$1" "$domain" "$scratch" "${@:3}"
