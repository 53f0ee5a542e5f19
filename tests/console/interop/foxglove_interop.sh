#!/usr/bin/env bash
# The official Foxglove client at weakgrid-console, and promtool on its metrics.
# usage: foxglove_interop.sh PROGRAMS BUILD_DIR SCENARIO
# exit code: 0 all agree, 1 not, 3 packages could not be installed or no DDS domain is free
set -euo pipefail
here=$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")
# shellcheck source=tests/support/npm_packages.sh
source "$here/../../support/npm_packages.sh"
# shellcheck source=tests/support/free_domain.sh
source "$here/../../support/free_domain.sh"
# shellcheck source=tests/support/promtool.sh
source "$here/../../support/promtool.sh"
into=$2/interop_console
find_promtool "$2/prometheus"
install_packages "$here" "$into"
exec 9>&-
cp "$here/foxglove_interop.mjs" "$into/"
free_domain
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
node "$into/foxglove_interop.mjs" "$1" "$domain" "$scratch" "$3"
"$promtool" check metrics < "$scratch/metrics.txt"
