// SPDX-License-Identifier: Apache-2.0
// The source of the examples: a video file.
#pragma once

#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>

namespace pedestrians {

using Jpeg = std::vector<std::byte>;

/// The video as JPEG frames, one after the other; from the start again at its end.
class Video {
 public:
  explicit Video(const std::string& path) : path_(path), capture_(path) {
    if (!capture_.isOpened()) throw std::runtime_error(path + ": cannot be opened as a video");
  }
  Jpeg frame() {
    cv::Mat image;
    if (!capture_.read(image)) {
      capture_.open(path_);
      if (!capture_.read(image)) throw std::runtime_error(path_ + ": has no frames");
    }
    std::vector<unsigned char> bytes;
    cv::imencode(".jpg", image, bytes, {cv::IMWRITE_JPEG_QUALITY, 95});
    const auto* data = reinterpret_cast<const std::byte*>(bytes.data());
    return {data, data + bytes.size()};
  }

 private:
  std::string path_;
  cv::VideoCapture capture_;
};

}  // namespace pedestrians
