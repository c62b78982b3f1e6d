#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# The module's source as it goes to /usr/src: without the emulators, which are for tests.
# usage: install-source.sh PROJECT DESTINATION
set -eu
from=$1 to=$2
install -d "$to/kmod" "$to/include/uapi/xauto"
install -m 644 "$from/Kbuild" "$to"
install -m 644 "$from"/kmod/*.c "$from"/kmod/*.h "$from/kmod/Kbuild" "$to/kmod"
install -m 644 "$from"/include/uapi/xauto/*.h "$to/include/uapi/xauto"
install -m 755 "$from/packaging/dkms/build-for.sh" "$to"
