// SPDX-License-Identifier: Apache-2.0
#include "opencl.h"

#include <span>

namespace pedestrians {
namespace {

constexpr const char* kSource = R"cl(
__kernel void grey_full(__global const uchar* bgr, __global uchar* out) {
  const size_t i = get_global_id(0);
  out[i] = (uchar)((77 * bgr[3 * i + 2] + 150 * bgr[3 * i + 1] + 29 * bgr[3 * i] + 128) >> 8);
}
__kernel void grey_half(__global const uchar* full, __global uchar* out, const int full_width) {
  const int x = get_global_id(0), y = get_global_id(1), width = get_global_size(0);
  __global const uchar* a = full + 2 * y * full_width + 2 * x;
  __global const uchar* b = a + full_width;
  out[y * width + x] = (uchar)((a[0] + a[1] + b[0] + b[1] + 2) >> 2);
}
__kernel void majority(__global const uchar* mask, __global uchar* out) {
  const int x = get_global_id(0), y = get_global_id(1);
  const int width = get_global_size(0), height = get_global_size(1);
  int set = 0;
  for (int dy = -1; dy <= 1; ++dy)
    for (int dx = -1; dx <= 1; ++dx) {
      const int xx = x + dx, yy = y + dy;
      if (xx >= 0 && xx < width && yy >= 0 && yy < height) set += mask[yy * width + xx] != 0;
    }
  out[y * width + x] = set >= 5 ? 255 : 0;
}
)cl";

std::span<unsigned char> pixels(cv::Mat& image) {
  CV_Assert(image.isContinuous());
  return {image.data, image.total() * image.elemSize()};
}
std::span<const unsigned char> pixels(const cv::Mat& image) {
  CV_Assert(image.isContinuous());
  return {image.data, image.total() * image.elemSize()};
}
std::size_t size(int pixels) {
  return static_cast<std::size_t>(pixels);
}

}  // namespace

xauto::opencl::Program opencl_program() {
  return {.source = kSource};
}

xauto::Status to_grey(xauto::opencl::Session& cl, OpenClBuffers& buffers, const cv::Mat& bgr,
                      Grey& grey) {
  CV_Assert(bgr.type() == CV_8UC3);
  grey.full.create(bgr.size(), CV_8UC1);
  grey.half.create(bgr.rows / 2, bgr.cols / 2, CV_8UC1);
  XAUTO_TRY(cl.write(buffers.in, pixels(bgr)));
  XAUTO_TRY(cl.resize(buffers.out, grey.full.total()));
  XAUTO_TRY(cl.resize(buffers.half, grey.half.total()));
  XAUTO_TRY(cl.run("grey_full", {grey.full.total()}, buffers.in, buffers.out));
  XAUTO_TRY(cl.run("grey_half", {size(grey.half.cols), size(grey.half.rows)}, buffers.out,
                   buffers.half, cl_int{bgr.cols}));
  XAUTO_TRY(cl.read(buffers.out, pixels(grey.full)));
  return cl.read(buffers.half, pixels(grey.half));
}

xauto::Status clean_mask(xauto::opencl::Session& cl, OpenClBuffers& buffers, const cv::Mat& mask,
                         cv::Mat& clean) {
  CV_Assert(mask.type() == CV_8UC1);
  clean.create(mask.size(), CV_8UC1);
  XAUTO_TRY(cl.write(buffers.in, pixels(mask)));
  XAUTO_TRY(cl.resize(buffers.out, clean.total()));
  XAUTO_TRY(cl.run("majority", {size(mask.cols), size(mask.rows)}, buffers.in, buffers.out));
  return cl.read(buffers.out, pixels(clean));
}

}  // namespace pedestrians
