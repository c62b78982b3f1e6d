/* SPDX-License-Identifier: Apache-2.0 */
/* Stands in for VPI's vpi/Types.h, as ../cuda.h does for CUDA's: what xauto/vpi.h uses, from NVIDIA's documentation. */
#pragma once

#include <cstdint>

using VPIStream = struct VPIStreamImpl*;
using VPIImage = struct VPIImageImpl*;

enum VPIBackend : std::uint64_t {
  VPI_BACKEND_CPU = 1ULL << 0,
  VPI_BACKEND_CUDA = 1ULL << 1,
  VPI_BACKEND_PVA = 1ULL << 2,
  VPI_BACKEND_VIC = 1ULL << 3,
};
