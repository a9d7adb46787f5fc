#!/bin/sh
# uninstall.sh [--purge]
#
# Stops and removes the service and the program; safe to run again. Configuration and learnt state stay, so that an
# installation later goes on where this one ended; --purge removes them too.
set -eu
[ "$(id -u)" = 0 ] || { echo "uninstall.sh: must be run as root" >&2; exit 2; }
case ${1:-} in
  '' | --purge) ;;
  *) echo "uninstall.sh: unknown word $1; valid: --purge" >&2; exit 2 ;;
esac

if [ -d /run/systemd/system ] && [ -e /etc/systemd/system/bms-gateway.service ]; then
  systemctl disable --now --quiet bms-gateway
fi
rm -f /etc/systemd/system/bms-gateway.service /etc/sysctl.d/60-bms-gateway.conf
if [ -d /run/systemd/system ]; then systemctl daemon-reload; fi
rm -rf /opt/bms-gateway /var/cache/bms-gateway /var/cache/private/bms-gateway
if [ "${1:-}" = --purge ]; then
  rm -rf /etc/bms-gateway /var/lib/bms-gateway /var/lib/private/bms-gateway
else
  echo "Kept: /etc/bms-gateway and /var/lib/bms-gateway (--purge removes them)"
fi
