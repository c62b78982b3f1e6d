// SPDX-License-Identifier: Apache-2.0
// How many stream priorities a GPU has, asked of CUDA's driver where it is installed.
#pragma once

namespace xauto::kernel {

/// Of GPU `index`. 0: nobody says, or it has one. It makes a context for as long as it asks. `library`: another one in tests.
[[nodiscard]] int cuda_stream_levels(int index = 0, const char* library = "libcuda.so.1");

}  // namespace xauto::kernel
