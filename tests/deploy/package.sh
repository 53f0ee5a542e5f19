#!/usr/bin/env bash
# The Debian package of a build: what it holds, that lintian has nothing to say, that what it holds works where it is
# unpacked, and that manual pages and completion tell of every option. usage: package.sh BUILD
set -euo pipefail
build=$1
source=$(dirname -- "$(dirname -- "$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")")")
root=$(mktemp -d)
trap 'rm -rf -- "$root"' EXIT
fail() { echo "package.sh: $*" >&2; exit 1; }

"$source/deploy/package" --build "$build" --output "$root/out" > "$root/said" || { cat "$root/said"; fail "no package"; }
deb=$(ls "$root"/out/weakgrid_*.deb)
lintian --allow-root --fail-on error,warning "$deb" || fail "lintian has findings"

dpkg-deb -x "$deb" "$root/tree"
dpkg-deb -e "$deb" "$root/control"
version=$(sed -n 's/^project(weakgrid VERSION \([0-9.]*\).*/\1/p' "$source/CMakeLists.txt")
[ "$(dpkg-deb -f "$deb" Version)" = "$version" ] || fail "version $(dpkg-deb -f "$deb" Version), not $version"
[ "$(cat "$root/control/conffiles")" = /etc/weakgrid/example.toml ] || fail "conffiles: $(cat "$root/control/conffiles")"
for script in postinst prerm postrm; do sh -n "$root/control/$script"; done
if grep -E 'systemctl +(--[a-z]+ +)*(enable|start|restart)|deb-systemd-(helper|invoke)' "$root/control"/p*; then fail "a script enables or starts something"; fi
grep -q systemd-sysusers "$root/control/postinst" || fail "nobody makes the user"

programs=(weakgrid weakgrid-plant weakgrid-controller weakgrid-unit weakgrid-gateway weakgrid-recorder weakgrid-replayer weakgrid-console)
# Debian 12 keeps these outside /usr, its successors do not.
lib=usr/lib
[ "$(. /etc/os-release && echo "${VERSION_ID:-}")" != 12 ] || lib=lib
files=("$lib"/systemd/system/weakgrid-{plant,controller,unit,gateway,recorder,console}@.service "$lib/systemd/system/weakgrid@.target"
  "$lib/udev/rules.d/60-weakgrid.rules" usr/lib/sysusers.d/weakgrid.conf usr/share/weakgrid/weakgrid.idl
  usr/share/weakgrid/settings/paper-weak.toml usr/share/doc/weakgrid/{README,deploy,services}.md.gz)
for folder in dds security metrics; do
  [ ! -d "$source/deploy/$folder" ] || files+=("usr/share/weakgrid/$folder")
done
for program in "${programs[@]}"; do
  files+=("usr/bin/$program" "usr/share/man/man1/$program.1.gz" "usr/share/bash-completion/completions/$program")
done
for file in "${files[@]}"; do [ -e "$root/tree/$file" ] || fail "$file: not in the package"; done
# Nothing of the place it was built in.
if grep -rlF -e "$source" -e "$root" "$root/tree" "$root/control"; then fail "names folders of the build"; fi

export PATH=$root/tree/usr/bin:$PATH
cd /
for program in "${programs[@]}"; do
  [ "$(command -v "$program")" = "$root/tree/usr/bin/$program" ] || fail "$program: which?"
  [[ "$("$program" --version)" == "weakgrid $version, "* ]] || fail "$program --version: $("$program" --version)"
  if readelf -d "$root/tree/usr/bin/$program" | grep -E 'R(UN)?PATH'; then fail "$program has a path of its own for libraries"; fi
done
weakgrid simulate "$root/tree/usr/share/weakgrid/settings/paper-weak.toml" > "$root/simulated" || { cat "$root/simulated"; fail "the unpacked program does not simulate"; }

# Every name after two spaces in a --help is in the manual page and is completed.
help=$("$source/deploy/manual/help.sh" "$root/tree/usr/bin")
options=0
# shellcheck source=/dev/null
. "$root/tree/usr/share/bash-completion/completions/weakgrid"
complete_line() { COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=(); _weakgrid || true; }
declare -A page
for program in "${programs[@]}"; do
  said=$(man --warnings -l "$root/tree/usr/share/man/man1/$program.1.gz" 2>&1 > "$root/page")
  [ -z "$said" ] || fail "$program.1: $said"
  page[$program]=$(MANWIDTH=1000 man -l "$root/tree/usr/share/man/man1/$program.1.gz" | col -b)
  lexgrog "$root/tree/usr/share/man/man1/$program.1.gz" > /dev/null || fail "$program.1 has no name for apropos"
done
while IFS= read -r line; do
  case $line in
    '@@ '*) read -r -a command <<< "${line#@@ }" ;;
    '  -'*)
      names=${line#  }
      for name in $(tr , ' ' <<< "${names%% *}"); do
        complete_line "${command[@]}" "$name"
        [[ " ${COMPREPLY[*]} " == *" $name "* ]] || fail "${command[*]} $name: not completed"
        [[ ${page[${command[0]}]} == *"$name"* ]] || fail "${command[*]} $name: not in the manual"
        options=$((options + 1))
      done
      ;;
  esac
done <<< "$help"
[ "$options" -gt 100 ] || fail "only $options options seen"
complete_line weakgrid ''
[ "${#COMPREPLY[@]}" -eq "$(sed -n '/^@@ weakgrid$/,/^@@ weakgrid /{/^Subcommands:/,/^$/{/^  [a-z]/p}}' <<< "$help" | wc -l)" ] || fail "weakgrid <tab>: ${COMPREPLY[*]}"
complete_line weakgrid authority ''
[ "${COMPREPLY[*]}" = "take release" ] || fail "weakgrid authority <tab>: ${COMPREPLY[*]}"
complete_line weakgrid set --keep p
[ "${COMPREPLY[*]}" = "p power-factor" ] || fail "weakgrid set --keep p<tab>: ${COMPREPLY[*]}"
complete_line weakgrid plot --no-such
[ "${#COMPREPLY[@]}" -eq 0 ] || fail "completes what is not there: ${COMPREPLY[*]}"
echo "package.sh: $(basename -- "$deb"), $(stat -c %s "$deb") bytes, $(find "$root/tree" -type f | wc -l) files, $options options"
