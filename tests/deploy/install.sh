#!/usr/bin/env bash
# deploy/install and back again: nothing left but what people have changed or made. usage: install.sh BUILD
set -euo pipefail
build=$1
source=$(dirname -- "$(dirname -- "$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")")")
root=$(mktemp -d)
fail() { echo "install.sh: $*" >&2; exit 1; }
run() { DESTDIR=$root "$source/deploy/install" "$@" > "$root.said" 2>&1 || { cat "$root.said"; fail "deploy/install $* fails"; }; }
trap 'rm -rf -- "$root" "$root.said"' EXIT

for prefix in /usr/local /opt/weakgrid /usr; do
  export PREFIX=$prefix
  etc=$prefix/etc
  [ "$prefix" != /usr ] || etc=/etc
  run --build "$build"
  unit=$root$prefix/lib/systemd/system/weakgrid-gateway@.service
  grep -qx "ExecStart=$prefix/bin/weakgrid-gateway --settings $etc/weakgrid/%i.toml" "$unit" || fail "$(grep Exec "$unit")"
  "$root$prefix/bin/weakgrid" simulate "$root$prefix/share/weakgrid/settings/unfiltered-x01.toml" > /dev/null 2>&1 && fail "holds what it does not"
  [ $? -eq 1 ] || fail "the installed program does not simulate"
  run --uninstall
  [ -z "$(find "$root" -type f)" ] || fail "left below $prefix: $(find "$root" -type f)"
done

# What people have made and changed stays, also when it is installed over.
run --build "$build"
echo '# mine' | tee -a "$root/etc/weakgrid/example.toml" > "$root/etc/weakgrid/feeder.toml"
run --build "$build"
grep -q mine "$root/etc/weakgrid/example.toml" || fail "installing over it has taken the settings"
run --uninstall
[ "$(cd "$root" && find . -type f | sort | tr '\n' ' ')" = "./etc/weakgrid/example.toml ./etc/weakgrid/feeder.toml " ] || fail "left: $(find "$root" -type f)"

if DESTDIR=$root "$source/deploy/install" --uninstall > /dev/null 2>&1; then fail "uninstalls what is not installed"; fi
if PREFIX=usr "$source/deploy/install" --build "$build" > /dev/null 2>&1; then fail "takes a relative prefix"; fi
if "$source/deploy/install" --no-such > /dev/null 2>&1; then fail "takes an unknown option"; fi
