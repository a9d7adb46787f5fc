#!/bin/sh
# install.sh [--python PYTHON] [WHEEL|CHECKOUT]
#
# Installs or updates the gateway as a service; safe to run again. WHEEL|CHECKOUT: what pip installs, default: the
# checkout that this script lies in. Without a network set pip's own PIP_NO_INDEX=1 and PIP_FIND_LINKS=folder.
#   /opt/bms-gateway/venv            the program
#   /etc/bms-gateway/                the configuration: the example is put there if there is none, else it stays
#   /etc/systemd/system/             the unit
#   /etc/sysctl.d/60-bms-gateway.conf  room for two seconds of a full bus in the kernel's receive buffer
# What it does not do: start the service, set up the interface. It says how.
set -eu
umask 022

python=python3
if [ "${1:-}" = --python ]; then python=$2; shift 2; fi
here=$(cd "$(dirname "$0")" && pwd)
source=${1:-$(dirname "$here")}
case $python in /*) ;; */*) python=$PWD/$python ;; esac
case $source in /*) ;; *) source=$PWD/$source ;; esac
home=/opt/bms-gateway
config=/etc/bms-gateway
buffer=8388608

fail() { echo "install.sh: $*" >&2; exit 2; }
[ "$(id -u)" = 0 ] || fail "must be run as root"
[ -e "$source" ] || fail "no such wheel or checkout: $source"
# root writes and runs what lies there: a directory of anybody else's, or a link to one, would give that one root's rights
own() {
  mkdir -p "$1"
  [ -n "$(find "$1" -maxdepth 0 -type d -user 0 ! -perm /022)" ] ||
    fail "$1 must be a directory of root's, no link, that nobody else can write to: see ls -ld $1"
}
own "$home"
own "$config"
for file in "$here"/example/*.toml "$here/bms-gateway.service"; do
  [ -f "$file" ] && [ ! -L "$file" ] || fail "$file must be a plain file: what a link leads to is not copied"
done
# Python would load modules from the folder that root happens to be in, whoever that folder belongs to
cd /
"$python" -I -c 'import sys; sys.exit(sys.version_info < (3, 11))' || fail "needs Python 3.11 or later, $python is older"

# A new version goes into a folder of its own and takes the old one's place when it is whole: a service that restarts
# in between, or a failed download, finds the old version as it was.
next=$home/venv-$(date +%Y%m%d%H%M%S)-$$
trap 'rm -rf "$next"' EXIT
"$python" -I -m venv "$next"
"$next/bin/python" -I -m pip install --quiet --disable-pip-version-check "$source"
"$next/bin/python" -I -c 'import bms_gateway' || fail "the installed package does not load"
before=$(readlink "$home/venv" 2>/dev/null || true)
ln -sfn "$next" "$home/venv.new"
mv -T "$home/venv.new" "$home/venv"
trap - EXIT
if [ -n "$before" ] && [ "$before" != "$next" ]; then rm -rf "$before"; fi

for file in "$here"/example/*.toml; do
  name=$(basename "$file")
  [ -e "$config/$name" ] || install -T -m 644 "$file" "$config/$name"
done
install -T -m 644 "$here/bms-gateway.service" /etc/systemd/system/bms-gateway.service
# the service has no right to go beyond the system's limit, and the usual one holds 60 ms of a full bus
if [ "$(cat /proc/sys/net/core/rmem_max)" -lt "$buffer" ]; then
  mkdir -p /etc/sysctl.d
  echo "net.core.rmem_max = $buffer" >/etc/sysctl.d/60-bms-gateway.conf
  echo "$buffer" >/proc/sys/net/core/rmem_max || echo "install.sh: net.core.rmem_max takes effect after a restart" >&2
fi
if [ -d /run/systemd/system ]; then
  systemctl daemon-reload
  if systemctl is-active --quiet bms-gateway; then systemctl restart bms-gateway; fi
fi

cat <<END
Installed in $home. Next:
  1. edit $config/gateway.toml, then: $home/venv/bin/bms-gateway check $config/gateway.toml
  2. bring the bus up, for example: cp $here/can0.network /etc/systemd/network/ && networkctl reload
  3. systemctl enable --now bms-gateway
END
