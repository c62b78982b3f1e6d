#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Our selftests as the kernel installs them: tests/kselftest/ is put into the frame of a kernel's tree, and that tree's make does the rest.
# usage: install-kselftest.sh BIN OUT [MAKE_ARGUMENT ...]      BIN: a folder with the programs; OUT gets run_kselftest.sh and what it runs
set -euo pipefail
bin=$(realpath "$1") out=$(realpath -m "$2")
shift 2
here=$(dirname "$(realpath "$0")")
root=$(realpath "$here/../..")
source=$("$here/fetch-source.sh")
tree=$out.tree
rm -rf "$tree" "$out"
mkdir -p "$tree"
cp -r "$source/scripts" "$source/tools" "$tree"
cp -r "$root/tests/kselftest" "$tree/tools/testing/selftests/xauto"
make -s -C "$tree/tools/testing/selftests" TARGETS=xauto FORCE_TARGETS=1 XAUTO="$root" XAUTO_BIN="$bin" KSFT_INSTALL_PATH="$out" "$@" install >"$out.log" 2>&1 ||
  { tail -n 20 "$out.log" >&2; exit 1; }
rm -rf "$tree"
