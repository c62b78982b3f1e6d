#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Takes vtest.avi out of Debian's opencv-doc package into build/pedestrians/, without installing the package
# (90 MB, and machines that leave out /usr/share/doc would drop the video).
set -euo pipefail
cd "$(dirname "$0")/.."
video=build/pedestrians/vtest.avi
[ ! -s "$video" ] || exit 0
mkdir -p build/pedestrians
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
chmod 755 "$folder"
echo "pedestrians: fetching the video from Debian's package opencv-doc"
if ! (cd "$folder" && { apt-get download opencv-doc || { apt-get update && apt-get download opencv-doc; }; }) >"$folder/log" 2>&1; then
  tail -n 5 "$folder/log" >&2
  echo "pedestrians: opencv-doc cannot be downloaded (as root, run: apt-get update)" >&2
  exit 1
fi
dpkg-deb --fsys-tarfile "$folder"/opencv-doc_*.deb |
  tar -xO ./usr/share/doc/opencv-doc/examples/data/vtest.avi >"$folder/vtest.avi"
mv "$folder/vtest.avi" "$video"
