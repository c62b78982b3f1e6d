// SPDX-License-Identifier: Apache-2.0
#include "kernel/cuda_levels.h"

#include <gtest/gtest.h>

namespace xauto::kernel {
namespace {

TEST(CudaLevels, AreAskedOfTheDriverIfThereIsOne) {
  EXPECT_EQ(cuda_stream_levels(0, "libnot-there.so.1"), 0);
  EXPECT_EQ(cuda_stream_levels(0, "libc.so.6"), 0) << "another library has no such functions";
  EXPECT_EQ(cuda_stream_levels(0, XAUTO_STAND_IN_CUDA), 6);
  EXPECT_EQ(cuda_stream_levels(0, XAUTO_STAND_IN_CUDA), 6) << "what it made has gone";
  EXPECT_EQ(cuda_stream_levels(3, XAUTO_STAND_IN_CUDA), 0) << "no such GPU";
}

}  // namespace
}  // namespace xauto::kernel
