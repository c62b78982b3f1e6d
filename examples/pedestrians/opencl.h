// SPDX-License-Identifier: Apache-2.0
// The OpenCL implementations of two stages. Same results as stages.h, bit for bit.
#pragma once

#include <opencv2/core.hpp>

#include <xauto/opencl.h>

#include "stages.h"

namespace pedestrians {

/// The kernels of both stages.
[[nodiscard]] xauto::opencl::Program opencl_program();

/// What a stage has on the device, kept from frame to frame.
struct OpenClBuffers {
  xauto::opencl::Buffer in, out, half;
};

[[nodiscard]] xauto::Status to_grey(xauto::opencl::Session& cl, OpenClBuffers& buffers,
                                    const cv::Mat& bgr, Grey& grey);
[[nodiscard]] xauto::Status clean_mask(xauto::opencl::Session& cl, OpenClBuffers& buffers,
                                       const cv::Mat& mask, cv::Mat& clean);

}  // namespace pedestrians
