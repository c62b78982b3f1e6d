/* SPDX-License-Identifier: Apache-2.0 */
/* Stands in for VPI's vpi/Stream.h. */
#pragma once

#include "Status.h"
#include "Types.h"

extern "C" {
VPIStatus vpiStreamCreate(std::uint64_t flags, VPIStream* stream);
void vpiStreamDestroy(VPIStream stream);
VPIStatus vpiStreamSync(VPIStream stream);
}
