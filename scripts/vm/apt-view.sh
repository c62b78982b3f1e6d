#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# A private view of the Debian archive: own sources, lists and cache below DIR, so that packages of other suites can be looked up and
# downloaded (never installed) while the machine's own sources stay as they are. Needs no root.
# usage: apt-view.sh DIR "ARCH [ARCH]" SUITE...      then: APT_CONFIG=DIR/apt.conf apt-get download ...
set -euo pipefail
dir=$(realpath -m "$1") archs=$2
shift 2

# The mirror that this machine uses for bookworm serves the other suites too.
mirror_of() {
  local pattern=$1 default=$2 uri
  uri=$(grep -hsE '^URIs:|^deb ' /etc/apt/sources.list /etc/apt/sources.list.d/*.{list,sources} 2>/dev/null |
    grep -oE 'https?://[^ ]+' | grep -E "$pattern" | head -n 1 || true)
  echo "${uri:-$default}"
}
mirror=${XAUTO_MIRROR:-$(mirror_of '/debian/?$' http://deb.debian.org/debian)}
security=${XAUTO_SECURITY_MIRROR:-$(mirror_of '/debian-security/?$' http://deb.debian.org/debian-security)}

mkdir -p "$dir/lists/partial" "$dir/cache/archives/partial"
: >"$dir/status"
for suite in "$@"; do
  case $suite in *-security) uri=$security ;; *) uri=$mirror ;; esac
  echo "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] $uri $suite main"
done >"$dir/sources.list"

cat >"$dir/apt.conf" <<CONF
Dir::Etc::sourcelist "$dir/sources.list";
Dir::Etc::sourceparts "/dev/null";
Dir::Etc::preferences "/dev/null";
Dir::Etc::preferencesparts "/dev/null";
Dir::State::lists "$dir/lists";
Dir::State::status "$dir/status";
Dir::Cache "$dir/cache";
APT::Architecture "${archs%% *}";
APT::Architectures { $(for arch in $archs; do printf '"%s"; ' "$arch"; done) };
APT::Sandbox::User "$(id -un)";
Acquire::Languages "none";
Acquire::Retries "3";
CONF
APT_CONFIG=$dir/apt.conf apt-get update -qq
