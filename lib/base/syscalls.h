// SPDX-License-Identifier: Apache-2.0
// System calls that the headers of Ubuntu 20.04 (JetPack 5) do not name, though its kernel has them.
// Their numbers are the same on every architecture.
#pragma once

#include <sys/syscall.h>

#ifndef SYS_close_range
#define SYS_close_range 436
#endif
#ifndef CLOSE_RANGE_CLOEXEC
#define CLOSE_RANGE_CLOEXEC 4U
#endif
#ifndef SYS_pidfd_getfd
#define SYS_pidfd_getfd 438
#endif
