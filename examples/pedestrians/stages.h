// SPDX-License-Identifier: Apache-2.0
// The stages of the pedestrian pipeline as plain functions on OpenCV types: what the XNodes of
// main.cc call. Pure apart from the state passed in, single-threaded, and deterministic for given
// frames.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/video/background_segm.hpp>

namespace pedestrians {

/// The grey image in two sizes: HOG wants the full one, background subtraction half of it.
struct Grey {
  cv::Mat full, half;  ///< CV_8UC1; half has half the width and height
};

struct Detection {
  cv::Rect box;      ///< in pixels of the full frame
  double score = 0;  ///< HOG's weight plus the share of the box that is foreground
};

struct Track {
  int id = 0;
  cv::Rect2d box;
  cv::Point2d velocity;  ///< pixels per frame
  int age = 0, missed = 0;
};

[[nodiscard]] cv::Mat decode(const std::vector<std::byte>& jpeg);

/// grey = (77 R + 150 G + 29 B + 128) / 256; half = the rounded mean of 2 x 2. Integers, so that
/// the OpenCL implementation (opencl.h) gives exactly the same.
void to_grey(const cv::Mat& bgr, Grey& grey);

/// People by OpenCV's HOG detector with its default people SVM.
[[nodiscard]] std::vector<Detection> detect_people(const cv::Mat& grey);

[[nodiscard]] cv::Ptr<cv::BackgroundSubtractorMOG2> make_background();
/// 255 where `half` differs from the background, which learns from it.
void subtract_background(cv::BackgroundSubtractorMOG2& background, const cv::Mat& half,
                         cv::Mat& mask);

/// A pixel is foreground if at least 5 of the 9 around it are; borders count as background.
void clean_mask(const cv::Mat& mask, cv::Mat& clean);

/// Keeps people that move, and adds moving blobs of a person's shape that HOG missed.
[[nodiscard]] std::vector<Detection> fuse(const std::vector<Detection>& people,
                                          const cv::Mat& foreground_half);

/// Greedy association by overlap, constant velocity.
class Tracker {
 public:
  [[nodiscard]] std::vector<Track> update(const std::vector<Detection>& detections);

 private:
  std::vector<Track> tracks_;
  int next_id_ = 1;
};

/// Where the centre of `track` will be in each of the next `frames` frames.
[[nodiscard]] std::vector<cv::Point2d> predict(const Track& track, int frames);

/// Boxes, ids and predicted paths drawn onto a colour image.
void annotate(cv::Mat& image, const std::vector<Track>& tracks, int path_frames);

}  // namespace pedestrians
