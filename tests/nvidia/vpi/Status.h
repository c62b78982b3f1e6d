/* SPDX-License-Identifier: Apache-2.0 */
/* Stands in for VPI's vpi/Status.h. */
#pragma once

#include <cstdint>

constexpr int VPI_MAX_STATUS_MESSAGE_LENGTH = 256;
enum VPIStatus {
  VPI_SUCCESS = 0,
  VPI_ERROR_INVALID_ARGUMENT = 2,
  VPI_ERROR_NOT_IMPLEMENTED = 1,
  VPI_ERROR_INTERNAL = 10,
};

extern "C" {
const char* vpiStatusGetName(VPIStatus status);
VPIStatus vpiGetLastStatusMessage(char* message, std::int32_t length);
}
