#!/bin/sh
# Prints what every program says of itself with --help, each command of `weakgrid` too, after a line "@@ NAME". Of this
# come the manual pages and the completion: neither can tell of an option that is not there, or leave one out.
# usage: help.sh FOLDER-OF-THE-PROGRAMS
set -eu
programs=$1

say() { # program and commands
  program=$1
  shift
  # The default of --name tells who builds, and where.
  help=$("$programs/$program" "$@" --help | sed "s/=[^ =]*@$(uname -n)/=USER@HOST/")
  printf '@@ %s\n%s\n' "$program${*:+ $*}" "$help"
  for command in $(printf '%s\n' "$help" | sed -n '/^Subcommands:/,/^$/s/^  \([a-z]\{1,\}\) .*/\1/p'); do
    say "$program" "$@" "$command"
    program=${program%% *}
  done
}

for name in weakgrid weakgrid-plant weakgrid-controller weakgrid-unit weakgrid-gateway weakgrid-recorder weakgrid-replayer weakgrid-console; do
  say "$name"
done
