#!/usr/bin/env bash
# The package's whole life in a Debian of its own that is booted (debootstrap, systemd-nspawn): install, run under
# systemd, killed, stuck, real-time wishes, shared memory, upgrade, removal, purge. Takes minutes and needs root and Debian's
# package sources, so nobody runs it but by hand. usage: cycle.sh DEB [FOLDER]
# FOLDER: such a Debian to start from, made there when it is not there; a copy of it is used.
set -euo pipefail
[ $# -ge 1 ] && [ -f "$1" ] || { sed -n '2,5s/^# //p' "$0" >&2; exit 2; }
deb=$(readlink -f -- "$1")
here=$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")
work=$(mktemp -d)
trap 'rm -rf --one-file-system -- "$work"' EXIT
base=${2:-$work/base}
for tool in debootstrap systemd-nspawn; do
  command -v "$tool" > /dev/null || { echo "cycle.sh: no $tool: install debootstrap and systemd-container" >&2; exit 3; }
done

if [ ! -d "$base/etc" ]; then
  mirror=$(sed -n 's/^URIs: //p; s/^deb \(\[[^]]*\] \)\?\([^ ]*\) .*/\2/p' /etc/apt/sources.list /etc/apt/sources.list.d/* 2> /dev/null | head -1)
  debootstrap --variant=minbase --include=systemd,systemd-sysv,dbus,udev,procps bookworm "$base" "$mirror" > "$work/debootstrap.log" ||
    { tail -5 "$work/debootstrap.log" >&2; exit 3; }
fi
cp -a "$base" "$work/root"
cp "$deb" "$work/root/weakgrid.deb"
# The next version, with nothing else new.
dpkg-deb -R "$deb" "$work/next"
sed -i 's/^Version: .*/&+next/' "$work/next/DEBIAN/control"
dpkg-deb -b --root-owner-group "$work/next" "$work/root/next.deb" > /dev/null

# With the host's network and before it boots: what the package depends on.
echo "cycle.sh: installing $(basename -- "$deb")"
cp -L /etc/resolv.conf "$work/root/etc/resolv.conf" 2> /dev/null || true
SECONDS=0
chroot "$work/root" /bin/sh -euc '
  export DEBIAN_FRONTEND=noninteractive
  apt-get -qq update
  apt-get -qq install --yes --no-install-recommends /weakgrid.deb' > "$work/apt.log" 2>&1 ||
  { tail -20 "$work/apt.log" >&2; echo "cycle.sh: it does not install" >&2; exit 1; }
echo "cycle.sh: installed in $SECONDS s, booting"

install -m 755 "$here/cycle_inside.sh" "$work/root/cycle"
cat > "$work/root/etc/systemd/system/cycle.service" <<'UNIT'
[Unit]
After=multi-user.target
SuccessAction=poweroff-force
FailureAction=poweroff-force
[Service]
Type=oneshot
Environment=HOME=/root DEBIAN_FRONTEND=noninteractive
ExecStart=/bin/sh -c '/cycle > /cycle.log 2>&1; echo $? > /cycle.status; journalctl --no-pager -u "weakgrid*" > /cycle.journal'
[Install]
WantedBy=default.target
UNIT
ln -s ../cycle.service "$work/root/etc/systemd/system/multi-user.target.wants/cycle.service"
# It may do to real-time scheduling and memory what a machine of its own may: a service in it that has no capability can
# do with them what its limits say, no more.
timeout 400 systemd-nspawn --quiet --register=no --keep-unit --boot --private-network --directory="$work/root" \
  --capability=CAP_SYS_NICE,CAP_IPC_LOCK --system-call-filter='@resources @memlock' \
  < /dev/null > "$work/boot.log" 2>&1 || true
cat "$work/root/cycle.log" 2> /dev/null || { tail -20 "$work/boot.log" >&2; echo "cycle.sh: it does not boot" >&2; exit 3; }
status=$(cat "$work/root/cycle.status")
[ "$status" -eq 0 ] || tail -60 "$work/root/cycle.journal"
exit "$status"
