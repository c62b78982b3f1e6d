// SPDX-License-Identifier: Apache-2.0
// What is around the nets: pixels to their inputs, their outputs to faces and lines. Pure functions.
#pragma once

#include <array>
#include <span>
#include <vector>

#include <opencv2/core.hpp>

namespace perception {

struct Face {
  cv::Rect2f box;  ///< in pixels of the frame
  float score = 0;
};

struct Line {
  cv::Point2f from, to;  ///< in pixels of the frame
  float score = 0;
};

/// At most so many heads are looked at per frame: an XNode's time has to have an upper end.
inline constexpr std::size_t kMostHeads = 4;

/// Squares around the heads of standing people, the highest boxes first, each whole within the frame.
[[nodiscard]] std::vector<cv::Rect> heads_of(const std::vector<cv::Rect>& people, cv::Size frame);

/// BlazeFace's input: `size` x `size` RGB, from -1 to 1, of a square of the frame.
void to_face_input(const cv::Mat& bgr, const cv::Rect& square, int size, std::span<float> input);

/// BlazeFace's outputs: two grids of anchors, 16 x 16 cells of two and 8 x 8 cells of six. A cell's
/// score is a logit; its first four numbers are centre and extent, in pixels of the input, the centre
/// from the cell's own.
struct FaceOutputs {
  std::array<std::span<const float>, 2> scores, boxes;
};
/// Faces above a score of one half; of overlapping ones the best.
[[nodiscard]] std::vector<Face> to_faces(const FaceOutputs& outputs, int size,
                                         const cv::Rect& square);

/// M-LSD's input: `size` x `size` RGB, from 0 to 255, and a fourth channel of ones, of the whole frame.
void to_line_input(const cv::Mat& bgr, int size, std::span<float> input);

/// M-LSD's outputs at half the input's size: whether a pixel is the middle of a line, and how far from
/// it both ends are. The best kMostLines above a score of kLineScore, by falling score.
[[nodiscard]] std::vector<Line> to_lines(std::span<const float> scores,
                                         std::span<const float> offsets, int size, cv::Size frame);
inline constexpr std::size_t kMostLines = 200;
inline constexpr float kLineScore = 0.2F;

}  // namespace perception
