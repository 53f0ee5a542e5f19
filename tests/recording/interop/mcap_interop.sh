#!/usr/bin/env bash
# Our recordings in the official MCAP readers, the official writer's in ours.
# usage: mcap_interop.sh MCAP_PEER BUILD_DIR
# exit code: 0 both read, 1 not, 3 packages could not be installed
set -euo pipefail
here=$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")
# shellcheck source=tests/support/npm_packages.sh
source "$here/../../support/npm_packages.sh"
into=$2/interop_mcap
install_packages "$here" "$into"
cp "$here/interop.mjs" "$here/decompress.mjs" "$into/"
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cd "$into"
node interop.mjs "$1" "$scratch/files"
