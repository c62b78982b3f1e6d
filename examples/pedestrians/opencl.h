// SPDX-License-Identifier: Apache-2.0
// The OpenCL implementations of two stages. Same results as stages.h, bit for bit.
#pragma once

#include <memory>

#include <opencv2/core.hpp>

#include "stages.h"

namespace pedestrians {

/// A device, its queue and our kernels. Throws std::runtime_error that says what is missing.
/// Threads: one at a time.
class OpenCl {
 public:
  OpenCl();
  ~OpenCl();
  OpenCl(const OpenCl&) = delete;
  OpenCl& operator=(const OpenCl&) = delete;

  void to_grey(const cv::Mat& bgr, Grey& grey);
  void clean_mask(const cv::Mat& mask, cv::Mat& clean);

 private:
  struct Device;
  std::unique_ptr<Device> device_;
};

}  // namespace pedestrians
