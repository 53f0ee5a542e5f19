#!/usr/bin/env bash
# The systemd units as installed below a prefix: systemd reads them without a word, finds what they start, and does
# not find them lax. usage: units.sh BUILD
set -euo pipefail
build=$1
root=$(mktemp -d)
trap 'rm -rf -- "$root"' EXIT
fail() { echo "units.sh: $*" >&2; exit 1; }

cmake --install "$build" --prefix "$root/usr" > /dev/null
units=$root/usr/lib/systemd/system

# Instances of the templates, as `systemctl enable` would have them.
for unit in "$units"/weakgrid*@.*; do
  name=$(basename -- "$unit")
  ln -s "$unit" "$units/${name/@./@here.}"
done
services=(plant controller unit gateway recorder console)
[ "$(ls "$units"/weakgrid-*@.service | wc -l)" -eq ${#services[@]} ] || fail "not the services that are checked: $(ls "$units")"
said=$(SYSTEMD_UNIT_PATH=$units: systemd-analyze verify --man=no --recursive-errors=yes \
  "$units"/weakgrid-{plant,controller,unit,gateway,recorder,console}@here.service "$units/weakgrid@here.target" 2>&1 |
  grep -i weakgrid) || true
[ -z "$said" ] || fail "systemd-analyze verify says:
$said"
grep -qx "ExecStart=$root/usr/bin/weakgrid-plant --settings $root/usr/etc/weakgrid/%i.toml" "$units/weakgrid-plant@.service" ||
  fail "the plant's unit does not start the installed program: $(grep ExecStart "$units/weakgrid-plant@.service")"

# It can tell: a unit that starts nothing, and one that nothing confines.
sed 's,^ExecStart=.*,ExecStart=/nowhere/weakgrid-plant,' "$units/weakgrid-plant@.service" > "$root/weakgrid-broken.service"
said=$(systemd-analyze verify --man=no "$root/weakgrid-broken.service" 2>&1 || true)
[[ $said == *"/nowhere/weakgrid-plant is not executable"* ]] || fail "verify finds nothing in a broken unit"
exposure() { # unit, at most: in tenths
  systemd-analyze security --offline=yes --threshold="$2" --no-pager "$1" > "$root/security" ||
    { grep -v ^✓ "$root/security"; fail "$1 is more exposed than $2 tenths"; }
}
printf '[Service]\nExecStart=/bin/true\n' > "$root/weakgrid-lax.service"
if (exposure "$root/weakgrid-lax.service" 20) > /dev/null 2>&1; then fail "security finds nothing in a lax unit"; fi
for service in "${services[@]}"; do
  # What counts: the loop's may have real-time scheduling and a device.
  case $service in gateway | recorder | console) most=15 ;; *) most=19 ;; esac
  exposure "$units/weakgrid-$service@here.service" $most
  tail -1 "$root/security"
done
