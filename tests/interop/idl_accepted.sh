#!/usr/bin/env bash
# Each reader of the wire contract accepts idl/weakgrid.idl as it stands and finds every struct in it.
set -euo pipefail

usage() {
  cat <<'EOF'
usage: idl_accepted.sh fastddsgen | idlc | omgidl BUILD_DIR

  fastddsgen   Fast DDS's generator, what Weakgrid itself is built with
  idlc         Cyclone DDS's compiler: another vendor's programs can join
  omgidl       @foxglove/omgidl-parser: viewers can read recordings; installed by npm into BUILD_DIR/interop

exit code: 0 accepted, 1 not, 2 bad usage, 3 the tool is missing or could not be installed
EOF
}

fail() {
  echo "idl_accepted.sh: $2" >&2
  exit "$1"
}

need() {
  command -v "$1" > /dev/null || fail 3 "$1 is not on the PATH: deploy/setup --tests installs it"
}

here=$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")
idl=$(readlink -f -- "$here/../../idl/weakgrid.idl")
structs() {
  sed 's,//.*,,' "$idl" | grep -oE '\bstruct +\w+' | awk '{print $2}'
}

# find_structs FILE PATTERN: the generated FILE holds, for each struct NAME, a match of PATTERN with NAME for %.
find_structs() {
  local name
  [ -s "$1" ] || fail 1 "no $1 was generated"
  for name in $(structs); do
    grep -qE "${2/\%/$name}" "$1" || fail 1 "$1 lacks struct $name"
  done
}

# shellcheck source=tests/support/npm_packages.sh
source "$here/../support/npm_packages.sh"

[ -s "$idl" ] || fail 2 "there is no $idl"
[ -n "$(structs)" ] || fail 2 "$idl declares no struct"
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

case "${1:-} $#" in
  "fastddsgen 1")
    need fastddsgen
    (cd "$scratch" && fastddsgen -replace -cs -t "$scratch" -d "$scratch" "$idl") || fail 1 "fastddsgen refuses $idl"
    ending=h
    [ ! -s "$scratch/weakgrid.hpp" ] || ending=hpp   # since its version 3
    find_structs "$scratch/weakgrid.$ending" '^ *class %$'
    find_structs "$scratch/weakgridPubSubTypes.$ending" '^ *class %PubSubType '
    ;;
  "idlc 1")
    need idlc
    (cd "$scratch" && idlc "$idl" |& tee warnings) || fail 1 "idlc refuses $idl"
    [ ! -s "$scratch/warnings" ] || fail 1 "idlc has something to say about $idl, see above"
    find_structs "$scratch/weakgrid.h" '^typedef struct weakgrid_(\w+_)?%$'
    ;;
  "omgidl 2")
    need node
    need npm
    mkdir -p "$2"
    modules=$(readlink -f -- "$2")/interop
    install_packages "$here" "$modules"
    cd "$scratch"
    node "$here/idl_accepted_by_omgidl_parser.mjs" "$idl" "$modules"
    ;;
  "-h 1" | "--help 1") usage; exit 0 ;;
  *) usage >&2; exit 2 ;;
esac
echo "$1 accepts $(basename "$idl") with all its $(structs | wc -l) structs"
